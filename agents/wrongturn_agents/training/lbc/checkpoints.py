"""Files of trained agents: ``best.pt`` of the agent with a camera, ``privileged.pt`` of the other."""

from pathlib import Path
from typing import Any, Final

import torch

from wrongturn_agents.models.lbc import PrivilegedAgent, SensorimotorAgent, WaypointAgent
from wrongturn_agents.training.checkpoint import FIELDS, read, versions, write
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.lbc.config import ALGORITHM, PRIVILEGED, LBCConfig

BEST: Final = "best.pt"
PRIVILEGED_FILE: Final = "privileged.pt"
AGENTS: Final[dict[str, type[SensorimotorAgent] | type[PrivilegedAgent]]] = {
    ALGORITHM: SensorimotorAgent,
    PRIVILEGED: PrivilegedAgent,
}
"""Classes of the agents by algorithm."""


def save_agent(
    file: Path,
    algorithm: str,
    agent: WaypointAgent,
    config: LBCConfig,
    *,
    seed: int,
    steps: int,
    evaluation: dict[str, float],
) -> None:
    """Write an agent with its weights in half precision, as they are shipped.

    Args:
        file: the file.
        algorithm: ``lbc`` or ``lbc-privileged``.
        agent: the agent.
        config: settings of its training.
        seed: seed of its training.
        steps: samples that it learned from.
        evaluation: how it drives on held-out journeys; empty if it has not been evaluated.
    """
    weights = {name: tensor.detach().cpu() for name, tensor in agent.state_dict().items()}
    halved = {name: tensor.half() if tensor.is_floating_point() else tensor for name, tensor in weights.items()}
    content = {"algorithm": algorithm, "seed": seed, "config": config.as_dict(), "steps": steps, "state_dict": halved}
    write(file, {**content, "evaluation": evaluation, "versions": versions()})


def is_lbc(file: Path | str) -> bool:
    """Return whether a file is the checkpoint of one of these agents; False for a file that cannot be read."""
    try:
        found = read(Path(file))
    except TrainingError:
        return False
    return isinstance(found, dict) and found.get("algorithm") in AGENTS


def load_agent(file: Path | str, device: torch.device | str = "cpu") -> tuple[WaypointAgent, dict[str, Any]]:
    """Return the agent of a checkpoint, ready to drive in float32, and the checkpoint.

    Raises:
        TrainingError: the file is missing, damaged, or no checkpoint of one of these agents.
    """
    found = read(Path(file), "checkpoint", "the best.pt or privileged.pt of 'wrongturn train lbc'")
    if not isinstance(found, dict) or any(not isinstance(found.get(name), kind) for name, kind in FIELDS.items()):
        raise TrainingError(f"checkpoint {file}: holds no agent of lbc; name a run's best.pt or privileged.pt")
    if found["algorithm"] not in AGENTS:
        raise TrainingError(f"checkpoint {file}: is of {found['algorithm']}; name one of {', '.join(AGENTS)}")
    config = LBCConfig.of(found["config"])
    agent = AGENTS[found["algorithm"]](config.width)
    try:
        agent.load_state_dict(found["state_dict"])
    except (RuntimeError, TypeError, AttributeError) as error:
        raise TrainingError(f"checkpoint {file}: its weights are not as this version has them; train anew") from error
    if not all(tensor.isfinite().all() for tensor in agent.state_dict().values()):
        raise TrainingError(f"checkpoint {file}: its weights are not finite; train anew")
    return agent.to(device).eval(), found
