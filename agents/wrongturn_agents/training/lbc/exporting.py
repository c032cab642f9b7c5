"""One ONNX file of an agent of "Learning by Cheating": from an observation and a memory to an action."""

from pathlib import Path

from wrongturn_agents.models.waypoint_control import MEMORY
from wrongturn_agents.training.export.export import Agreement, Observations, Precision
from wrongturn_agents.training.export.remembering import write_remembering
from wrongturn_agents.training.export.writing import check_target
from wrongturn_agents.training.lbc.checkpoints import load_agent


def export_lbc(
    checkpoint: Path | str,
    file: Path | str,
    precision: Precision | str = Precision.FP32,
    *,
    name: str | None = None,
    observations: Observations | None = None,
    compared: Observations | None = None,
) -> Agreement | None:
    """Write an agent as one ONNX file.

    Args:
        checkpoint: a run's ``best.pt`` or ``privileged.pt``.
        file: the file to write.
        precision: precision of the weights.
        name: the agent's name on the leaderboard; the algorithm by default.
        observations: (n, ...) for each input, to calibrate int8 with; recorded by default.
        compared: recorded observations on which to compare the file's actions with the checkpoint's. The file's
            metadata keeps the result.

    Returns:
        The comparison, if there was one.

    Raises:
        TrainingError: the file is no checkpoint, or the ONNX file cannot be written.
    """
    file, precision = Path(file), Precision(precision)
    check_target(file, name)
    agent, told = load_agent(checkpoint)
    return write_remembering(
        agent, agent.keys, MEMORY, told, file, precision, name=name, observations=observations, compared=compared
    )
