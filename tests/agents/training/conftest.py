import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")
# The helpers beside these tests are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parent))

WIDTHS = (8, 8, 16, 16)


@pytest.fixture(scope="package", autouse=True)
def one_thread() -> Iterator[None]:
    """Such small batches are slower with threads that wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture
def small_networks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Build the paper's agents with few channels and one block in each stage."""
    from wrongturn_agents.models import encoders
    from wrongturn_agents.models.linknet import LinkNetDecoder
    from wrongturn_agents.models.nature_cnn import NatureCNN
    from wrongturn_agents.models.resnet import ResNet34

    deep = WIDTHS[-1] * 2 * 6
    monkeypatch.setattr(encoders, "NatureCNN", partial(NatureCNN, widths=(8, 16, 16)))
    monkeypatch.setattr(encoders, "ResNet34", partial(ResNet34, widths=WIDTHS, depths=(1, 1, 1, 1)))
    monkeypatch.setattr(encoders, "LinkNetDecoder", partial(LinkNetDecoder, widths=WIDTHS))
    monkeypatch.setattr(encoders, "_DEEP", deep)
    monkeypatch.setattr(encoders.PictureEncoder, "width", deep)


@pytest.fixture(scope="module")
def small_marln() -> Iterator[None]:
    """Build MaRLn with few channels and one block in each stage."""
    from wrongturn_agents.models.marln import Marln
    from wrongturn_agents.training.methods.marln import method

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(method, "Marln", partial(Marln, widths=WIDTHS, depths=(1, 1, 1, 1)))
        yield
