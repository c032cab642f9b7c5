"""Files of a run: the agent's weights, and the state from which a run goes on."""

import contextlib
import platform
import warnings
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final

import torch
from torch import nn

from wrongturn_agents.models import ActorCritic, build
from wrongturn_agents.training.config import PPOConfig, config_of
from wrongturn_agents.training.errors import TrainingError

_FIELDS: Final[dict[str, type]] = {
    "algorithm": str,
    "seed": int,
    "config": dict,
    "steps": int,
    "state_dict": dict,
    "evaluation": dict,
    "versions": dict,
}

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
        TrainingError: the file is missing, or is no checkpoint of this version's.
    """
    found = read(Path(path), "checkpoint", "a run's best.pt or last.pt")
    if not isinstance(found, dict) or not found.keys() >= _FIELDS.keys():
        raise TrainingError(f"checkpoint {path}: is none; name a run's best.pt or last.pt")
    wrong = [name for name, kind in _FIELDS.items() if not isinstance(found[name], kind)]
    if wrong:
        raise TrainingError(f"checkpoint {path}: its {wrong[0]} is damaged; name a run's best.pt or last.pt")
    try:
        config_of(found["algorithm"], found["config"])
    except TrainingError as error:
        raise TrainingError(f"checkpoint {path}: {error}") from error
    return found


def model_of(checkpoint: dict[str, Any], device: torch.device | str = "cpu") -> ActorCritic:
    """The agent of a checkpoint, ready to drive.

    Raises:
        TrainingError: its weights are other ones.
    """
    # The first checkpoints do not tell: theirs were ReLUs.
    model = build(checkpoint["algorithm"], activation=checkpoint["config"].get("activation", "relu"))
    weights = checkpoint["state_dict"]
    try:
        missing, unexpected = model.load_state_dict(weights, strict=False)
    except (RuntimeError, TypeError, AttributeError) as error:
        raise TrainingError("checkpoint: its weights are not as this version has them; train it anew") from error
    lacking = [name for name in missing if not name.startswith(UNDRIVEN)]
    if lacking or unexpected:
        raise TrainingError(f"checkpoint: {(lacking + unexpected)[0]}: is not as this version has it; train it anew")
    for name, tensor in model.state_dict().items():
        if not tensor.isfinite().all():
            raise TrainingError(f"checkpoint: {name}: is not finite, so that it cannot drive; name an earlier one")
    return model.to(device).eval()


def write(path: Path, content: Any) -> None:
    """Write a file in one go: one that was interrupted leaves the old one as it was.

    Raises:
        TrainingError: it cannot be written, as on a full disk.
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
    """What :func:`write` wrote, on the CPU; nothing in it is executed.

    Args:
        path: of the file.
        what: the argument that named it.
        wanted: what is to be named.

    Raises:
        TrainingError: the file is missing or broken.
    """
    try:
        if not path.is_file():
            raise TrainingError(f"{what} {path}: there is no such file; name {wanted}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # torch's, of what it makes of files that are not its own
            return torch.load(path, map_location="cpu", weights_only=True)
    except TrainingError:
        raise
    except OSError as error:
        raise TrainingError(f"{what} {path}: cannot be read ({error.strerror or error}); name {wanted}") from error
    except Exception as error:  # torch raises another for each way of being broken
        raise TrainingError(f"{what} {path}: is damaged, or none of a run's files; name {wanted}") from error


def versions() -> dict[str, str]:
    """Of what the result hangs on."""
    found = {"python": platform.python_version()}
    for name in ("torch", "stable-baselines3", "numpy", "numba", "wrongturn-agents", "wrongturn-service"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "unknown"
    return found
