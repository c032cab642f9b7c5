"""``wrongturn export sb3``: write a policy of Stable-Baselines3 as an ONNX file."""

from pathlib import Path
from typing import Annotated

import typer

from wrongturn_agents.training.errors import require_extra


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
    from wrongturn_sb3 import export, policy  # noqa: PLC0415 - keeps the program's start quick

    policy.check_files(file, vecnormalize)
    loaded = " and ".join(str(each) for each in (file, vecnormalize) if each is not None)
    typer.echo(f"Loading {loaded} runs code that is named inside: export only files that you trust.", err=True)
    made = export.export_sb3(file, out, vecnormalize=vecnormalize, actions=actions, name=name, description=description)
    size = out.stat().st_size
    shown = f"{size / 1e6:.1f} MB" if size >= 1e6 else f"{size / 1e3:.1f} kB"
    typer.echo(
        f"{out}: {made.algorithm}, {made.track} track, {shown}; takes "
        f"{', '.join(made.inputs)}; gives {', '.join(made.outputs)}"
    )
    typer.echo(
        f"On {export.COMPARED} sampled observations its actions differ from the policy's by {made.greatest:.2g} at most"
        + (f" (by more than {export.TOLERANCE} on {made.exceptions})" if made.exceptions else "")
    )
