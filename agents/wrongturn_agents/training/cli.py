"""``wrongturn train`` and ``wrongturn score``. Nothing heavy is imported before one of them runs."""

import os
import time
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated

import typer

from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_agents.training.errors import TrainingError, require_extra
from wrongturn_protocol.json_output import STDOUT, JsonTo, check_json_file, give_json

_Threads = Annotated[
    int | None, typer.Option(min=1, help="Threads of simulation and torch; all cores by default. Example: --threads 2")
]
_ALGORITHM = f"Algorithm: {', '.join(sorted(entry_points(group='wrongturn.methods').names))}. Example: ppo-image"
_Device = Annotated[str, typer.Option(help="Device: cpu, cuda or auto. Example: --device cpu")]


def train(
    algorithm: Annotated[str, typer.Argument(help=_ALGORITHM)],
    seed: Annotated[
        int | None,
        typer.Option(help="Seed of weights, drives and actions; 1 by default. Example: --seed 3", show_default=False),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(
            min=1, help="Length in environment steps; for lbc samples, for doubting pictures. Example: --steps 2000000"
        ),
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(help="Time for the whole run, in minutes of the wall clock. Example: --minutes 60")
    ] = None,
    device: _Device = "auto",
    directory: Annotated[
        Path | None,
        typer.Option(help="Run's directory; runs/ALGORITHM-SEED by default. Example: --directory runs/first"),
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Continue the run in the directory.")] = False,
    teacher: Annotated[
        Path | None,
        typer.Option(
            help="lbc: learn from this privileged agent and train none. Example: --teacher runs/lbc-1/privileged.pt"
        ),
    ] = None,
    num_envs: Annotated[
        int | None, typer.Option(min=1, help="Number of cars that drive side by side. Example: --num-envs 8")
    ] = None,
    threads: _Threads = None,
    option: Annotated[
        list[str] | None, typer.Option(help="A setting of the algorithm. Example: --option gamma=0.98")
    ] = None,
) -> None:
    """Train an agent by a shipped or installed method: overnight on a laptop, in minutes on a GPU.

    Example: wrongturn train doubting-segmentation --minutes 10
    """
    require_extra()
    from wrongturn_agents.training.method import find_method  # noqa: PLC0415
    from wrongturn_agents.training.progress import Display  # noqa: PLC0415
    from wrongturn_agents.training.run import train as run  # noqa: PLC0415

    settings = find_method(algorithm).settings()
    options = list(option or [])
    for field, given in (("num_envs", num_envs), ("teacher", teacher)):
        if given is not None and not hasattr(settings, field):
            raise TrainingError(f"--{field.replace('_', '-')}: {algorithm} has no use for it; leave it out")
        if given is not None:
            options.append(f"{field}={given}")
    with Display(algorithm) as display:
        best = run(
            algorithm,
            directory=directory or Path("runs") / f"{algorithm}-{1 if seed is None else seed}",
            seed=seed,
            steps=steps,
            minutes=minutes,
            device=device,
            resume=resume,
            threads=threads,
            options=options,
            on_row=display.row,
            on_note=display.note,
        )
    typer.echo(f"The best is {best}.")


def score(
    checkpoint: Annotated[
        str,
        typer.Argument(
            help="A run's best.pt, last.pt or privileged.pt, a .onnx file, or an agent's name. Example: ppo-image"
        ),
    ],
    suite: Annotated[str, typer.Option(help="Id of the suite. Example: --suite navigation@1")] = WRONG_COMMAND,
    json_to: JsonTo = None,
    device: _Device = "auto",
    threads: _Threads = None,
    batch: Annotated[int | None, typer.Option(min=1, help="Number of trials at once. Example: --batch 30")] = None,
    traffic: Annotated[
        bool,
        typer.Option(
            "--traffic",
            help="Drive only the trials with other road users, beside simple traffic instead of SUMO's: an estimate. "
            "Example: --suite navigation@1 --traffic",
        ),
    ] = False,
) -> None:
    """Drive a suite with a checkpoint or a registered agent in this process, and report how each trial ended.

    Example: wrongturn score runs/ppo-image-3/best.pt --suite wrong-command@3
    """
    require_extra()
    from wrongturn_agents.training.score import score as run  # noqa: PLC0415
    from wrongturn_agents.training.score import score_agent, summary  # noqa: PLC0415

    if json_to is not None and traffic:
        raise TrainingError(
            "--json: an estimate beside simple traffic is no result; leave it out, or drive these trials over a "
            "service with `wrongturn run AGENT --suite navigation@1 --task navigation_dynamic --json FILE`"
        )
    check_json_file(json_to)
    begin = time.monotonic()
    if _is_agent(checkpoint):
        if device not in {"auto", "cpu"}:
            raise TrainingError(f"device: is {device!r}; a registered agent runs on the CPU, so leave --device out")
        results = score_agent(checkpoint, suite, threads=threads, traffic=traffic)
    else:
        results = run(checkpoint, suite, device=device, threads=threads, batch=batch, traffic=traffic)
    if json_to != STDOUT:
        for line in summary(results):
            typer.echo(line)
        typer.echo(f"{len(results['trials'])} trials in {time.monotonic() - begin:.0f} s.")
    give_json(results, json_to)


def _is_agent(name: str) -> bool:
    """Return whether a name is an agent's. A bare word that is no file is an agent's, misspelt."""
    from wrongturn_agents.registry import list_agents  # noqa: PLC0415

    is_path = Path(name).suffix == ".pt" or len(Path(name).parts) > 1 or os.path.isfile(name)  # noqa: PTH113 - takes any name
    return name.endswith((".onnx", ".zip")) or name in {agent.name for agent in list_agents()} or not is_path
