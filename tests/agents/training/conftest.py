import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
# The helpers beside these tests are imported by their plain names.
sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1])]

from small_networks import WIDTHS, small_networks  # noqa: E402


@pytest.fixture(scope="package", autouse=True)
def one_thread() -> Iterator[None]:
    """Such small batches are slower with threads that wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(name="small_networks", scope="module")
def _small_networks() -> Iterator[None]:
    """Build the paper's agents with few channels and one block in each stage."""
    with small_networks():
        yield


@pytest.fixture(scope="module")
def small_marln() -> Iterator[None]:
    """Build MaRLn with few channels and one block in each stage."""
    from wrongturn_agents.models.marln import Marln
    from wrongturn_agents.training.methods.marln import method

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(method, "Marln", partial(Marln, widths=WIDTHS, depths=(1, 1, 1, 1)))
        yield


@pytest.fixture(scope="module")
def small_lbc() -> Iterator[None]:
    """Build both agents of Learning by Cheating with one block in each stage."""
    from wrongturn_agents.models import lbc

    resnet = lbc.new_resnet
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lbc, "new_resnet", lambda channels, _, widths: resnet(channels, (1, 1, 1, 1), widths))
        yield
