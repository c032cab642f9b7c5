"""One ONNX file of MaRLn: pictures and memory in, action and memory out."""

from pathlib import Path
from typing import Final

from wrongturn_agents.models.marln import MEMORY
from wrongturn_agents.training.checkpoint import load_checkpoint
from wrongturn_agents.training.export.export import Agreement, Observations, Precision
from wrongturn_agents.training.export.remembering import write_remembering
from wrongturn_agents.training.export.writing import check_target
from wrongturn_agents.training.marln.network import marln_of

KEYS: Final = ("speed", "steering", "command", "rgb")


def export_marln(
    checkpoint: Path | str,
    file: Path | str,
    precision: Precision | str = Precision.FP32,
    *,
    name: str | None = None,
    observations: Observations | None = None,
    compared: Observations | None = None,
) -> Agreement | None:
    """Write a checkpoint of MaRLn as an ONNX file.

    Args:
        checkpoint: a run's ``best.pt`` or ``last.pt``.
        file: the file to write.
        precision: precision of the weights.
        name: the agent's name on the leaderboard; ``marln`` by default.
        observations: (n, ...) for each input, to calibrate int8 with; recorded by default.
        compared: recorded observations on which to compare the file's actions with the checkpoint's. The file's
            metadata keeps the result.

    Returns:
        The comparison, if there was one.

    Raises:
        TrainingError: the file is no checkpoint of MaRLn, or the ONNX file cannot be written.
    """
    file, precision = Path(file), Precision(precision)
    check_target(file, name)
    told = load_checkpoint(checkpoint)
    return write_remembering(
        marln_of(told), KEYS, MEMORY, told, file, precision, name=name, observations=observations, compared=compared
    )
