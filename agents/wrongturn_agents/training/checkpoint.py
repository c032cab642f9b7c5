"""A run's files: weights of agents, and the state from which a run continues."""

import contextlib
import os
import platform
import warnings
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import torch
from torch import nn

from wrongturn_agents.errors import why_no_file
from wrongturn_agents.models import ActorCritic, build
from wrongturn_agents.training.config import config_of
from wrongturn_agents.training.drives_config import DrivesConfig
from wrongturn_agents.training.errors import TrainingError

FIELDS: Final[dict[str, type]] = {
    "algorithm": str,
    "seed": int,
    "config": dict,
    "steps": int,
    "state_dict": dict,
    "evaluation": dict,
    "versions": dict,
}
"""What a checkpoint holds, and of which type."""

UNDRIVEN: Final = ("encoder.decoder.", "encoder.segmenting.")
"""First parts of the names of weights that only learning needs. A checkpoint may lack these weights."""


def save_checkpoint(
    path: Path, model: nn.Module, config: DrivesConfig, *, seed: int, steps: int, evaluation: dict[str, float]
) -> None:
    """Write an agent: its weights, its configuration and its held-out evaluation."""
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


def is_path(name: str) -> bool:
    """Return whether a name can only mean a file: it ends in ``.pt``, names a folder as well, or such a file exists."""
    return Path(name).suffix == ".pt" or len(Path(name).parts) > 1 or os.path.isfile(name)  # noqa: PTH113 - takes any name


def load_checkpoint(path: Path | str) -> dict[str, Any]:
    """Load on the CPU what :func:`save_checkpoint` wrote.

    Raises:
        TrainingError: the file is missing, or is no checkpoint of this version.
    """
    found = read(Path(path), "checkpoint", "a run's best.pt or last.pt")
    if not isinstance(found, dict) or not found.keys() >= FIELDS.keys():
        raise TrainingError(f"checkpoint {path}: holds no agent; name a run's best.pt or last.pt")
    wrong = [name for name, kind in FIELDS.items() if not isinstance(found[name], kind)]
    if wrong:
        raise TrainingError(f"checkpoint {path}: its {wrong[0]} is damaged; name a run's best.pt or last.pt")
    try:
        config_of(found["algorithm"], found["config"])
    except TrainingError as error:
        raise TrainingError(f"checkpoint {path}: {error}") from error
    return found


def model_of(checkpoint: dict[str, Any], device: torch.device | str = "cpu") -> ActorCritic:
    """Build the agent of a checkpoint, ready to drive.

    Raises:
        TrainingError: its weights do not fit this version's networks, or are not finite.
    """
    # The first checkpoints do not name their activation: it was ReLU.
    model = build(checkpoint["algorithm"], activation=checkpoint["config"].get("activation", "relu"))
    load_weights(model, checkpoint["state_dict"], lambda name: name.startswith(UNDRIVEN))
    return model.to(device).eval()


def load_weights(model: nn.Module, weights: dict[str, torch.Tensor], spare: Callable[[str], bool]) -> None:
    """Load a checkpoint's weights into a network.

    Args:
        model: the network.
        weights: weights by name.
        spare: returns whether a checkpoint may lack a weight, by its name.

    Raises:
        TrainingError: they do not fit this version's network, or are not finite.
    """
    try:
        missing, unexpected = model.load_state_dict(weights, strict=False)
    except (RuntimeError, TypeError, AttributeError) as error:
        raise TrainingError("checkpoint: its weights are not as this version has them; train it anew") from error
    lacking = [name for name in missing if not spare(name)]
    if lacking or unexpected:
        raise TrainingError(f"checkpoint: {(lacking + unexpected)[0]}: is not as this version has it; train it anew")
    for name, tensor in model.state_dict().items():
        if not tensor.isfinite().all():
            raise TrainingError(f"checkpoint: {name}: is not finite, so that it cannot drive; name an earlier one")


def write(path: Path, content: Any) -> None:
    """Write a file all at once: if the process is interrupted, the old file stays.

    Raises:
        TrainingError: the file cannot be written, for example because the disk is full.
    """
    beside = path.with_name(path.name + ".part")
    try:
        torch.save(content, beside)
        beside.replace(path)
    except (OSError, RuntimeError) as error:  # torch's own writer raises the latter
        with contextlib.suppress(OSError):
            beside.unlink(missing_ok=True)
        reason = error.strerror if isinstance(error, OSError) else "is the disk full?"
        raise TrainingError(f"{path}: cannot be written ({reason}); make room, and go on with --resume") from error


def read(path: Path, what: str = "file", wanted: str = "one that a run wrote") -> Any:
    """Load on the CPU what :func:`write` wrote. Nothing in the file is executed.

    Args:
        path: the file.
        what: argument that named the file, for the error.
        wanted: what the user should name instead, for the error.

    Raises:
        TrainingError: the file is missing or damaged.
    """
    try:
        if not path.is_file():
            raise TrainingError(f"{what} {path}: {why_no_file(path)}; name {wanted}")
        opened = path.open("rb")
    except OSError as error:
        raise TrainingError(f"{what} {path}: cannot be read ({error.strerror or error}); name {wanted}") from error
    with opened, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch's warnings about other programs' files
        try:
            return torch.load(opened, map_location="cpu", weights_only=True)
        except Exception as error:  # torch raises different exceptions for different damage, also an OSError
            raise TrainingError(f"{what} {path}: is damaged, or none of a run's files; name {wanted}") from error


def versions() -> dict[str, str]:
    """Return the versions that a result depends on, by package."""
    found = {"python": platform.python_version()}
    for name in ("torch", "stable-baselines3", "numpy", "numba", "wrongturn-agents", "wrongturn-service"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
