"""``wrongturn train`` and ``wrongturn score``. Nothing heavy is imported before one of them runs."""

import os
import time
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any

import typer

from wrongturn_agents.suites import WRONG_COMMAND, suite_named
from wrongturn_agents.training.errors import TrainingError, require_extra
from wrongturn_protocol.json_output import STDOUT, JsonTo, check_json_file, give_json

_Threads = Annotated[
    int | None, typer.Option(min=1, help="Threads of simulation and torch; all cores by default. Example: --threads 2")
]
_ALGORITHM = (
    f"Algorithms: {', '.join(sorted(entry_points(group='wrongturn.methods').names))}. Several train side by side. "
    "Example: ppo-image"
)
_Device = Annotated[str, typer.Option(help="Device: cpu, cuda or auto. Example: --device cpu")]


def train(
    algorithm: Annotated[list[str], typer.Argument(help=_ALGORITHM)],
    seed: Annotated[
        int | None,
        typer.Option(help="Seed of weights, drives and actions; 1 by default. Example: --seed 3", show_default=False),
    ] = None,
    seeds: Annotated[
        str | None, typer.Option(help="Seeds of runs that are trained side by side. Example: --seeds 1-5")
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
        typer.Option(
            help="Run's directory; runs/ALGORITHM-SEED by default. Runs side by side have theirs in it. "
            "Example: --directory runs/first"
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the run in the directory, or all runs that have not finished.")
    ] = False,
    teacher: Annotated[
        Path | None,
        typer.Option(
            help="lbc: learn from this privileged agent and train none. Example: --teacher runs/lbc-1/privileged.pt"
        ),
    ] = None,
    num_envs: Annotated[
        int | None, typer.Option(min=1, help="Number of cars that drive side by side. Example: --num-envs 8")
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Threads of simulation and torch, of each run; by default all cores together. Example: --threads 2",
        ),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(
            help="A setting of the algorithm, or of one of several. "
            "Example: --option gamma=0.98 --option ppo-image.waiters=0.5"
        ),
    ] = None,
    ray: Annotated[
        bool,
        typer.Option(
            "--ray", help="Train on the nodes of a Ray cluster: that of RAY_ADDRESS, or of this machine. Example: --ray"
        ),
    ] = False,
    gpus: Annotated[
        float | None, typer.Option(min=0, help="With --ray: GPUs of each run, or a share of one. Example: --gpus 0.2")
    ] = None,
) -> None:
    """Train agents by a shipped or installed method: overnight on a laptop, in minutes on a GPU.

    Example: wrongturn train ppo-image --seeds 1-5 --minutes 20
    """
    require_extra()
    limits: dict[str, Any] = {
        "steps": steps,
        "minutes": minutes,
        "device": device,
        "resume": resume,
        "threads": threads,
    }
    options = [*(option or []), *_as_options(algorithm, num_envs=num_envs, teacher=teacher)]
    if len(algorithm) > 1 or seeds is not None or ray:
        _train_several(algorithm, seed, seeds, directory or Path("runs"), options, ray, gpus, limits)
    elif gpus is not None:
        raise TrainingError("--gpus: is for --ray; leave it out")
    else:
        _train_one(algorithm[0], seed, directory, options, limits)


def _as_options(algorithms: list[str], **fields: Any) -> list[str]:
    from wrongturn_agents.training.method import find_method  # noqa: PLC0415

    given = {name: value for name, value in fields.items() if value is not None}
    for algorithm in algorithms:
        settings = find_method(algorithm).settings()
        for name in given:
            if not hasattr(settings, name):
                raise TrainingError(f"--{name.replace('_', '-')}: {algorithm} has no use for it; leave it out")
    return [f"{name}={value}" for name, value in given.items()]


def _train_one(
    algorithm: str, seed: int | None, directory: Path | None, options: list[str], limits: dict[str, Any]
) -> None:
    from wrongturn_agents.training.progress import Display  # noqa: PLC0415
    from wrongturn_agents.training.run import train as run  # noqa: PLC0415

    with Display(algorithm) as display:
        best = run(
            algorithm,
            directory=directory or Path("runs") / f"{algorithm}-{1 if seed is None else seed}",
            seed=seed,
            options=options,
            on_row=display.row,
            on_note=display.note,
            **limits,
        )
    typer.echo(f"The best is {best}.")


def _train_several(
    algorithms: list[str],
    seed: int | None,
    seeds: str | None,
    directory: Path,
    options: list[str],
    ray: bool,
    gpus: float | None,
    limits: dict[str, Any],
) -> None:
    from wrongturn_agents.training.side_by_side import seeds_of, side_by_side  # noqa: PLC0415

    if seed is not None and seeds is not None:
        raise TrainingError("--seeds: --seed is given too; leave one of them out")
    numbers = [1 if seed is None else seed] if seeds is None else seeds_of(seeds)
    side_by_side(algorithms, numbers, directory=directory, options=options, ray=ray, gpus=gpus, **limits)


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
    suite = suite_named(suite)
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
