"""``wrongturn export``: write a trained agent as an ONNX file that drives without torch."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer.core import TyperGroup

from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.errors import TrainingError, require_extra

_COMPARED = 200
_CHECKPOINT = "checkpoint"


class _Exports(TyperGroup):
    """Kinds of export. Without one, it is a checkpoint: ``wrongturn export CHECKPOINT FILE.onnx``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put ``checkpoint`` before arguments that name no kind."""
        if args and args[0] not in (*self.commands, *ctx.help_option_names):
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


@export.command("sb3")
def export_sb3(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE.zip",
            help="What model.save of Stable-Baselines3 wrote. Example: agent.zip",
            show_default=False,
        ),
    ],
    out: Annotated[
        Path,
        typer.Option("--out", help="File to write. Example: --out agent.onnx", metavar="FILE.onnx", show_default=False),
    ],
    *,
    vecnormalize: Annotated[
        Path | None,
        typer.Option(
            help="What VecNormalize.save wrote, if training normalised observations. Example: --vecnormalize stats.pkl",
            show_default=False,
        ),
    ] = None,
    actions: Annotated[
        Path | None,
        typer.Option(
            help="For discrete actions: a JSON file with a list for each action, of steer and accelerate, or of steer, "
            "throttle and brake. Example: --actions actions.json",
            show_default=False,
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(
            help="Name on the leaderboard; the file's by default. Example: --name my-agent", show_default=False
        ),
    ] = None,
    description: Annotated[
        str | None,
        typer.Option(
            help="One sentence for the leaderboard. Example: --description 'PPO on pictures'", show_default=False
        ),
    ] = None,
) -> None:
    """Export a policy of Stable-Baselines3: PPO, A2C, SAC, TD3, DDPG or DQN on an environment of Wrongturn.

    Loading FILE.zip runs code that it names: export only files that you trust. If you have a features extractor of your
    own, start the command in its folder, so that Python can import it.

    Example: wrongturn export sb3 agent.zip --out agent.onnx
    """
    require_extra()
    from wrongturn_agents.training.export import sb3, sb3_policy  # noqa: PLC0415

    sb3_policy.check_files(file, vecnormalize)
    loaded = " and ".join(str(each) for each in (file, vecnormalize) if each is not None)
    typer.echo(f"Loading {loaded} runs code that is named inside: export only files that you trust.", err=True)
    made = sb3.export_sb3(file, out, vecnormalize=vecnormalize, actions=actions, name=name, description=description)
    size = out.stat().st_size
    shown = f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.1f} kB"
    typer.echo(
        f"{out}: {made.algorithm}, {made.track} track, {shown}; takes "
        f"{', '.join(made.inputs)}; gives {', '.join(made.outputs)}"
    )
    typer.echo(
        f"On {sb3.COMPARED} sampled observations its actions differ from the policy's by {made.greatest:.2g} at most"
        + (f" (by more than {sb3.TOLERANCE} on {made.exceptions})" if made.exceptions else "")
    )
