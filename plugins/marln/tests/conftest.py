import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
# The agents' helpers are imported by their plain names.
sys.path[:0] = [str(Path(__file__).parents[3] / "tests" / "agents" / folder) for folder in ("training", ".")]

from small_networks import WIDTHS  # noqa: E402


@pytest.fixture(scope="module", autouse=True)
def _one_thread(one_thread: None) -> None: ...


@pytest.fixture(scope="module")
def small_marln() -> Iterator[None]:
    """Build MaRLn with few channels and one block in each stage."""
    from wrongturn_marln import method
    from wrongturn_marln.network import Marln

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(method, "Marln", partial(Marln, widths=WIDTHS, depths=(1, 1, 1, 1)))
        yield
