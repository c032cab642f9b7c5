"""Names that a reader could take for those of shipped agents."""

import pytest

from wrongturn_protocol.reserved_names import looks_like, misleads


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


@pytest.mark.parametrize(
    ("told", "names"),
    [
        ("it reads as if it were the operator's", ("operator", "0perat0r", "Admin")),
        ("it reads like an id", ("ow_ae118531a1c30f924bef7819", "AG-ae118531a1c3", "ev_0123456789abcdef01234567")),
        (None, ("ag_robotics", "ep_2026", "admins")),
    ],
)
def test_a_name_that_misleads(told: str | None, names: tuple[str, ...]) -> None:
    assert {misleads(name) for name in names} == {told}
