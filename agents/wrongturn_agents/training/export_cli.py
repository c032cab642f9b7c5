"""``wrongturn export``: a checkpoint as an ONNX file that drives without torch."""

from pathlib import Path
from typing import Annotated, Literal

import typer

_COMPARED = 200


def export(
    checkpoint: Annotated[Path, typer.Argument(help="A run's best.pt or last.pt.", show_default=False)],
    file: Annotated[Path, typer.Argument(metavar="FILE.onnx", help="What to write.", show_default=False)],
    *,
    precision: Annotated[
        Literal["fp32", "fp16", "int8"],
        typer.Option(help="Of the weights: as trained; stored in half; convolutions in 8 bits."),
    ] = "fp32",
    name: Annotated[
        str | None, typer.Option(help="On the leaderboard; by default the algorithm's.", show_default=False)
    ] = None,
    compare: Annotated[
        bool, typer.Option(help=f"Tell how far its actions are from the checkpoint's, on {_COMPARED} observations.")
    ] = True,
) -> None:
    """Write a trained agent as one ONNX file, which 'wrongturn run FILE.onnx' drives without torch."""
    from wrongturn_agents.training.errors import TrainingError  # noqa: PLC0415 - the program starts quickly without
    from wrongturn_client.invocation import python  # noqa: PLC0415

    try:
        from wrongturn_agents.training.checkpoint import load_checkpoint, model_of  # noqa: PLC0415
        from wrongturn_agents.training.export import export as exporting  # noqa: PLC0415
        from wrongturn_agents.training.recording import record_observations  # noqa: PLC0415
    except ImportError as error:
        raise TrainingError(
            f"export: {error.name} is not installed; install what it needs with: "
            f"{python()} -m pip install 'wrongturn-agents[training]'",
        ) from error
    model_of(load_checkpoint(checkpoint))  # names what cannot be, before minutes are spent on observations
    compared = record_observations("segmentation", _COMPARED, seed=1) if compare else None
    found = exporting.export(checkpoint, file, precision, name=name, compared=compared)
    typer.echo(f"{file}: {file.stat().st_size / 1e6:.1f} MB, sha256 {exporting.sha256(file)}")
    if found is not None:
        for control, mean, greatest in zip(("steer", "throttle", "brake"), found.mean, found.greatest, strict=True):
            typer.echo(f"{control}: differs from the checkpoint's by {mean:.2g} in the mean, {greatest:.2g} at most")
