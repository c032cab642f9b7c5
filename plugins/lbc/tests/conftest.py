import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
# The agents' helpers are imported by their plain names.
sys.path[:0] = [str(Path(__file__).parents[3] / "tests" / "agents" / folder) for folder in ("training", ".")]


@pytest.fixture(scope="module", autouse=True)
def _one_thread(one_thread: None) -> None: ...


@pytest.fixture(scope="module")
def small_lbc() -> Iterator[None]:
    """Build both agents of Learning by Cheating with one block in each stage."""
    from wrongturn_agents.models import lbc

    resnet = lbc.new_resnet
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lbc, "new_resnet", lambda channels, _, widths: resnet(channels, (1, 1, 1, 1), widths))
        yield
