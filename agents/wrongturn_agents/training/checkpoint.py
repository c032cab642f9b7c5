"""Files of a run: the agent's weights, and the state from which a run goes on."""

import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import torch
from torch import nn

from wrongturn_agents.models import ActorCritic, build
from wrongturn_agents.training.config import PPOConfig, config_of
from wrongturn_agents.training.errors import TrainingError

_FIELDS = {"algorithm", "seed", "config", "steps", "state_dict", "evaluation", "versions"}

UNDRIVEN: Final = ("encoder.decoder.", "encoder.segmenting.")
"""How the weights' names begin that only learning needs; a checkpoint may lack them."""


def save_checkpoint(
    path: Path, model: nn.Module, config: PPOConfig, *, seed: int, steps: int, evaluation: dict[str, float]
) -> None:
    """Write an agent: its weights, what it was trained with, and its held-out evaluation."""
    write(
        path,
        {
            "algorithm": config.algorithm,
            "seed": seed,
            "config": config.as_dict(),
            "steps": steps,
            "state_dict": {name: tensor.detach().cpu() for name, tensor in model.state_dict().items()},
            "evaluation": evaluation,
            "versions": versions(),
        },
    )


def load_checkpoint(path: Path | str) -> dict[str, Any]:
    """What :func:`save_checkpoint` wrote, on the CPU.

    Raises:
        TrainingError: the file is missing, or is no checkpoint.
    """
    found = read(Path(path))
    if not isinstance(found, dict) or not found.keys() >= _FIELDS:
        raise TrainingError(f"checkpoint {path}: is none; name the best.pt or last.pt of a run")
    return found


def model_of(checkpoint: dict[str, Any], device: torch.device | str = "cpu") -> ActorCritic:
    """The agent of a checkpoint, ready to drive.

    Raises:
        TrainingError: its weights are other ones.
    """
    config_of(checkpoint["algorithm"])  # names an unknown one
    # The first checkpoints do not tell: theirs were ReLUs.
    model = build(checkpoint["algorithm"], activation=checkpoint["config"].get("activation", "relu"))
    missing, unexpected = model.load_state_dict(checkpoint["state_dict"], strict=False)
    lacking = [name for name in missing if not name.startswith(UNDRIVEN)]
    if lacking or unexpected:
        raise TrainingError(f"checkpoint: {(lacking + unexpected)[0]}: is not as this version has it; train it anew")
    return model.to(device).eval()


def write(path: Path, content: Any) -> None:
    """Write a file in one go: one that was interrupted leaves the old one as it was."""
    beside = path.with_name(path.name + ".part")
    torch.save(content, beside)
    beside.replace(path)


def read(path: Path) -> Any:
    """What :func:`write` wrote, on the CPU; nothing in it is executed.

    Raises:
        TrainingError: the file is missing or broken.
    """
    if not path.is_file():
        raise TrainingError(f"{path}: there is no such file; name one that a run wrote")
    try:
        return torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        reason = str(error).partition("\n")[0]
        raise TrainingError(f"{path}: cannot be read ({reason}); name a file that a run wrote") from error


def versions() -> dict[str, str]:
    """Of what the result hangs on."""
    found = {"python": platform.python_version()}
    for name in ("torch", "stable-baselines3", "numpy", "numba", "wrongturn-agents", "wrongturn-service"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
