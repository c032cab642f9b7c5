"""``wrongturn export``: write a checkpoint as an ONNX file that drives without torch."""

from pathlib import Path
from typing import Annotated, Literal

import typer

_COMPARED = 200


def export(
    checkpoint: Annotated[Path, typer.Argument(help="A run's best.pt or last.pt.", show_default=False)],
    file: Annotated[Path, typer.Argument(metavar="FILE.onnx", help="File to write.", show_default=False)],
    *,
    precision: Annotated[
        Literal["fp32", "fp16", "int8"],
        typer.Option(help="Weights: as trained (fp32), stored in 16 bits (fp16), or convolutions in 8 bits (int8)."),
    ] = "fp32",
    name: Annotated[
        str | None, typer.Option(help="Name on the leaderboard; the algorithm by default.", show_default=False)
    ] = None,
    compare: Annotated[
        bool, typer.Option(help=f"Compare its actions with the checkpoint's on {_COMPARED} observations.")
    ] = True,
) -> None:
    """Write a trained agent as one ONNX file, which 'wrongturn run FILE.onnx' drives without torch."""
    from wrongturn_agents.training.errors import TrainingError  # noqa: PLC0415 - keeps the program's start quick
    from wrongturn_client.invocation import python  # noqa: PLC0415

    try:
        from wrongturn_agents.training.checkpoint import load_checkpoint, model_of  # noqa: PLC0415
        from wrongturn_agents.training.doubting.exporting import export_doubting  # noqa: PLC0415
        from wrongturn_agents.training.doubting.run import is_doubting  # noqa: PLC0415
        from wrongturn_agents.training.export import export as exporting  # noqa: PLC0415
        from wrongturn_agents.training.recording import record_observations  # noqa: PLC0415
    except ImportError as error:
        raise TrainingError(
            f"export: {error.name} is not installed; install what it needs with: "
            f"{python()} -m pip install 'wrongturn-agents[training]'",
        ) from error
    if is_doubting(checkpoint):
        export_doubting(checkpoint, file, precision, name=name)
        typer.echo(f"{file}: {file.stat().st_size / 1e6:.1f} MB, sha256 {exporting.sha256(file)}")
        return
    model_of(load_checkpoint(checkpoint))  # reports a damaged checkpoint before minutes go into observations
    compared = record_observations("segmentation", _COMPARED, seed=1) if compare else None
    found = exporting.export(checkpoint, file, precision, name=name, compared=compared)
    typer.echo(f"{file}: {file.stat().st_size / 1e6:.1f} MB, sha256 {exporting.sha256(file)}")
    if found is not None:
        for control, mean, greatest in zip(("steer", "throttle", "brake"), found.mean, found.greatest, strict=True):
            typer.echo(f"{control}: differs from the checkpoint's by {mean:.2g} on average, {greatest:.2g} at most")
