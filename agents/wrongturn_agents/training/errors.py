"""Errors of training."""

from importlib.util import find_spec

from wrongturn_agents.errors import AgentsError
from wrongturn_protocol.installing import install


class TrainingError(AgentsError, ValueError):
    """Error about a setting or file of a run. The message names it and the remedy."""


def require_extra() -> None:
    """Check that the packages of the extra *training* are installed."""
    missing = [name for name in ("torch", "stable_baselines3", "onnx", "wrongturn_sim") if find_spec(name) is None]
    if missing:
        raise TrainingError(
            f"{', '.join(missing)} is not installed; install what this needs with: "
            f"{install('wrongturn-agents[training]')}"
        )
