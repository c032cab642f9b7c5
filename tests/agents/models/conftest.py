from collections.abc import Callable

import pytest
import torch
from torch import Tensor

Batch = Callable[..., dict[str, Tensor]]


@pytest.fixture(scope="module", autouse=True)
def _one_thread(one_thread: None) -> None: ...


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
