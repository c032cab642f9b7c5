"""A run's files: weights of agents, and the state from which a run continues."""

import contextlib
import platform
import warnings
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import torch
from torch import nn

from wrongturn_agents.errors import why_no_file
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.settings import Settings

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


def save_checkpoint(
    path: Path,
    model: nn.Module,
    settings: Settings,
    *,
    seed: int,
    steps: int,
    evaluation: dict[str, Any],
    algorithm: str | None = None,
    halved: bool = False,
) -> None:
    """Write an agent: its weights, its settings and how it drives on held-out journeys."""
    weights = {name: tensor.detach().cpu().contiguous() for name, tensor in model.state_dict().items()}
    if halved:
        weights = {name: one.half() if one.is_floating_point() else one for name, one in weights.items()}
    told = {"algorithm": algorithm or settings.algorithm, "seed": seed, "config": settings.as_dict(), "steps": steps}
    write(path, {**told, "state_dict": weights, "evaluation": evaluation, "versions": versions()})


def load_checkpoint(path: Path | str) -> dict[str, Any]:
    """Load on the CPU what :func:`save_checkpoint` wrote."""
    found = read(Path(path), "checkpoint", "a run's best.pt or last.pt")
    if not isinstance(found, dict) or not found.keys() >= FIELDS.keys():
        raise TrainingError(f"checkpoint {path}: holds no agent; name a run's best.pt or last.pt")
    wrong = [name for name, kind in FIELDS.items() if not isinstance(found[name], kind)]
    if wrong:
        raise TrainingError(f"checkpoint {path}: its {wrong[0]} is damaged; name a run's best.pt or last.pt")
    return found


def load_weights(
    model: nn.Module,
    weights: dict[str, torch.Tensor],
    parts: tuple[str, ...] = ("",),
    what: str = "checkpoint",
    remedy: str = "train it anew",
) -> None:
    """Load weights by name into a network. They need those whose names begin with one of some parts.

    Raises:
        TrainingError: they do not fit, or are not finite. It begins with ``what``, and ends with ``remedy``.
    """
    try:
        missing, unexpected = model.load_state_dict(weights, strict=False)
    except (RuntimeError, TypeError, AttributeError) as error:
        raise TrainingError(f"{what}: its weights are not as this version has them; {remedy}") from error
    lacking = [name for name in missing if name.startswith(parts)]
    if lacking or unexpected:
        raise TrainingError(f"{what}: {(lacking + unexpected)[0]}: is not as this version has it; {remedy}")
    for name, tensor in model.state_dict().items():
        if not tensor.isfinite().all():
            raise TrainingError(f"{what}: {name}: is not finite, so that it cannot drive; name an earlier one")


def write(path: Path, content: Any) -> None:
    """Write a file all at once: if the process is interrupted, the old file stays."""
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
