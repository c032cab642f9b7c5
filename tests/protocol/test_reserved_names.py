"""Names that a reader could take for those of shipped agents."""

import pytest

from wrongturn_protocol.reserved_names import looks_like


@pytest.mark.parametrize(
    ("name", "shipped"),
    [
        ("careful", "careful"),
        ("CAREFUL", "careful"),
        ("C.a_r e-ful", "careful"),
        ("carefu1", "careful"),
        ("carefuI", "careful"),
        ("head 0n", "head-on"),
        ("pp0-lmage", "ppo-image"),
        ("u-tumer", "u-turner"),
        ("careful-2", None),
        ("carefully", None),
        ("my ppo", None),
    ],
)
def test_a_name_that_looks_like_a_shipped_one(name: str, shipped: str | None) -> None:
    assert looks_like(name) == shipped
