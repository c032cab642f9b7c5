"""``wrongturn export``: write a trained agent as an ONNX file that drives without torch."""

from pathlib import Path
from typing import Annotated, Any, Final, Literal

import typer
from typer.core import TyperGroup

from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.errors import TrainingError, require_extra
from wrongturn_client.plugins import entry_points, lazy_command

EXPORTS: Final = "wrongturn.exports"
"""Entry-point group of further kinds of export."""
_COMPARED = 200
_CHECKPOINT = "checkpoint"


class _Exports(TyperGroup):
    """Kinds of export, also of other packages. Without one, it is a checkpoint: ``export CHECKPOINT FILE.onnx``."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of the kinds."""
        return [*super().list_commands(ctx), *entry_points(EXPORTS)]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a kind by its name; None if there is none."""
        point = entry_points(EXPORTS).get(cmd_name)
        return super().get_command(ctx, cmd_name) if point is None else lazy_command(point)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put ``checkpoint`` before arguments that name no kind."""
        if args and args[0] not in (*self.list_commands(ctx), *ctx.help_option_names):
            args = [_CHECKPOINT, *args]
        return super().parse_args(ctx, args)


export = typer.Typer(
    cls=_Exports,
    help="Write a trained agent as one ONNX file, which 'wrongturn run FILE.onnx' drives without torch.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["--help", "-h"]},
    epilog="Examples: wrongturn export runs/ppo-image-3/best.pt ppo-image.onnx; "
    "wrongturn export sb3 agent.zip --out agent.onnx",
)


@export.callback()
def _kinds() -> None: ...  # keeps the kinds below it, although this package has one alone


@export.command(_CHECKPOINT)
def export_checkpoint(
    checkpoint: Annotated[
        Path,
        typer.Argument(
            help="A run's best.pt, last.pt or privileged.pt. Example: runs/ppo-image-3/best.pt", show_default=False
        ),
    ],
    file: Annotated[
        Path, typer.Argument(metavar="FILE.onnx", help="File to write. Example: ppo-image.onnx", show_default=False)
    ],
    *,
    precision: Annotated[
        Literal["fp32", "fp16", "int8"],
        typer.Option(
            help="Weights: as trained (fp32), stored in 16 bits (fp16), or convolutions in 8 bits (int8). "
            "Example: --precision fp16"
        ),
    ] = "fp32",
    name: Annotated[
        str | None,
        typer.Option(
            help="Name on the leaderboard; the algorithm by default. Example: --name my-agent", show_default=False
        ),
    ] = None,
    compare: Annotated[
        bool, typer.Option(help=f"Compare its actions with the checkpoint's on {_COMPARED} observations.")
    ] = True,
) -> None:
    """Export a checkpoint of 'wrongturn train'. The word 'checkpoint' can be left out.

    Example: wrongturn export runs/ppo-image-3/best.pt ppo-image.onnx
    """
    require_extra()
    from wrongturn_agents.training.drive import is_driver  # noqa: PLC0415 - keeps the program's start quick
    from wrongturn_agents.training.export.export import export as write  # noqa: PLC0415
    from wrongturn_agents.training.export.export import sha256  # noqa: PLC0415
    from wrongturn_agents.training.method import load  # noqa: PLC0415
    from wrongturn_agents.training.recording import record_observations  # noqa: PLC0415

    if not checkpoint.exists() and str(checkpoint) in SHIPPED_AGENTS:
        raise TrainingError(f"checkpoint: {checkpoint} is a shipped agent, an ONNX file already; name a run's best.pt")
    loaded = load(checkpoint)  # reports a damaged checkpoint before minutes go into observations
    compare = compare and is_driver(loaded.model)
    compared = record_observations(loaded.agent.track, _COMPARED, seed=1) if compare else None
    found = write(checkpoint, file, precision, name=name, compared=compared)
    typer.echo(f"{file}: {file.stat().st_size / 1e6:.1f} MB, sha256 {sha256(file)}")
    if found is not None:
        for control, mean, greatest in zip(("steer", "throttle", "brake"), found.mean, found.greatest, strict=True):
            typer.echo(f"{control}: differs from the checkpoint's by {mean:.2g} on average, {greatest:.2g} at most")
