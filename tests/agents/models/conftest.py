import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from torch import Tensor

sys.path.insert(0, str(Path(__file__).parents[1]))

from small_networks import small_networks

Batch = Callable[..., dict[str, Tensor]]


@pytest.fixture(scope="package", autouse=True)
def one_thread() -> Iterator[None]:
    """Such small batches are slower with threads that wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module", name="small_networks")
def _small_networks() -> Iterator[None]:
    """Build the agents of a module with few channels and one block in each stage."""
    with small_networks():
        yield


@pytest.fixture(scope="session")
def batch() -> Batch:
    """Makes observations of both tracks: noise for pictures, bands for segmentation."""

    def make(number: int = 2, seed: int = 0, command: int | None = None) -> dict[str, Tensor]:
        draw = torch.Generator().manual_seed(seed)
        commands = torch.randint(1, 5, (number, 1), generator=draw)
        return {
            "speed": torch.rand(number, 1, generator=draw) * 10,
            "steering": torch.rand(number, 1, generator=draw) * 2 - 1,
            "command": commands if command is None else torch.full((number, 1), command),
            "rgb": torch.randint(0, 256, (number, 64, 192, 3), dtype=torch.uint8, generator=draw),
            "segmentation": (torch.arange(64 * 192).view(64, 192) // 1118).to(torch.uint8).repeat(number, 1, 1),
        }

    return make


@pytest.fixture(scope="session")
def gradient_norm() -> Callable[[torch.nn.Module], float]:
    """The sum of the absolute gradients of a part; 0 where none arrived."""

    def norm(part: torch.nn.Module) -> float:
        return sum(float(p.grad.abs().sum()) for p in part.parameters() if p.grad is not None)

    return norm
