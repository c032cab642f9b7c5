"""``wrongturn whatif``: what an agent does in a stored drive with another command."""

import json
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, NamedTuple

import typer
from rich.table import Table

from wrongturn_agents.errors import AgentsError, RunError
from wrongturn_agents.progress import ProgressStyle, show_progress
from wrongturn_agents.registry import resolve, with_absolute_file
from wrongturn_agents.whatif_file import ForkResult, SweepFile, SweepResult
from wrongturn_agents.worker import GuardedAgent
from wrongturn_client import ApiError, Client
from wrongturn_client.evaluation_driver import drive_episode
from wrongturn_client.options import Url
from wrongturn_client.replayed import replayed_from
from wrongturn_client.tables import console, plain_table
from wrongturn_protocol import Command, EpisodeDetail
from wrongturn_protocol.installing import install
from wrongturn_protocol.json_output import STDOUT, JsonTo, check_json_file, give_json, write_json
from wrongturn_protocol.run_file import RunFile
from wrongturn_protocol.vehicle import DECISION_S
from wrongturn_protocol.words import name

if TYPE_CHECKING:
    from types import ModuleType

ROUTE: Final = "ROUTE"
Word = StrEnum("Word", {word: word for word in (*Command.__members__, ROUTE)})  # type: ignore[misc]
"""Commands by name, and the route's."""
_EVERY: Final = 0.5


class _Asked(NamedTuple):
    """What to fork, with which agent."""

    source: str
    agent: str
    url: str | None
    workers: int
    json_to: Path | None


def whatif(
    source: Annotated[
        str,
        typer.Argument(
            metavar="EPISODE|FILE|EVALUATION",
            help="Id of a finished episode of a service, the file of 'run --json', or a file with a trajectory; with "
            "--all, a FILE or the id of a finished evaluation. Example: run.json",
        ),
    ],
    *,
    agent: Annotated[
        str | None,
        typer.Option(
            help="The agent that drove, as 'wrongturn run' takes it; by default the shipped one of that name. "
            "Example: --agent model.onnx"
        ),
    ] = None,
    command: Annotated[
        Word | None,
        typer.Option(help="The other command; ROUTE is the route's, the right one. Example: --command LEFT"),
    ] = None,
    at: Annotated[
        float | None, typer.Option(min=0, help="When it begins, seconds after the start. Example: --at 3.2")
    ] = None,
    sweep: Annotated[bool, typer.Option("--sweep", help="Find the point of no return and the detection time.")] = False,
    every: Annotated[
        float, typer.Option(min=DECISION_S, help="Seconds between the first forks of a sweep. Example: --every 0.1")
    ] = _EVERY,
    every_trial: Annotated[
        bool, typer.Option("--all", help="Sweep all unsafe trials; goes on with what the file of --json has.")
    ] = False,
    episode: Annotated[
        str | None,
        typer.Option(
            metavar="ID", help="Which episode of a FILE: its id, or its trial's id. Example: --episode ep_1a2b"
        ),
    ] = None,
    workers: Annotated[
        int, typer.Option(min=1, help="With --all: processes of this machine. Example: --workers 4")
    ] = 1,
    post: Annotated[
        bool,
        typer.Option(
            "--post", help="Drive what was found at the service too, as practice, so that the EPISODE's page shows it."
        ),
    ] = False,
    url: Url = None,
    json_to: JsonTo = None,
    progress: Annotated[
        ProgressStyle, typer.Option(help="How to show progress on stderr. Example: --progress json")
    ] = ProgressStyle.AUTO,
) -> None:
    """Fork a finished episode: drive it again with another command from one moment on.

    Example: wrongturn whatif run.json --episode Town01.J3-S.infeasible.s17 --agent careful --command LEFT --at 3.2

    Example: wrongturn whatif run.json --agent careful --sweep --all --json sweep.json

    Example: wrongturn whatif ev_1a2b3c --agent careful --sweep --all --url http://127.0.0.1:8000

    WRONGTURN_TOKEN: the token of the agent that drove, for --post and for practice episodes.
    """
    if sweep and (command is not None or at is not None):
        raise RunError("--sweep: give it alone, or --command and --at without it")
    if not sweep and (command is None or at is None):
        raise RunError("--command, --at: give both, such as --command LEFT --at 3.2; or --sweep")
    if every_trial and (not sweep or episode is not None or post):
        raise RunError("--all: needs --sweep, and neither --episode nor --post")
    if post and Path(source).exists():
        raise RunError("--post: an EPISODE of a service can be driven there, not a FILE; leave it out")
    check_json_file(json_to)
    run = _run_of(source, url) if every_trial else None
    named = agent or _agent_of(source, url, run)
    resolve(named)
    asked = _Asked(source, with_absolute_file(named), url, workers, json_to)
    if run is not None:
        _sweep_all(run, asked, every, progress)
        return
    found = _core().whatif_of(asked.agent, str(Path.cwd()), replayed_from(source, episode, url).trajectory)
    if sweep:
        result = found.sweep(every)
        forks = _worth_posting(result)
    else:
        assert at is not None
        assert command is not None
        result = found.forked(at, None if command == ROUTE else Command[command])
        forks = [(result.at, result.command)]
    posted = [_post(asked, *one) for one in forks] if post else []
    _give(result, posted, json_to)


def _core() -> "ModuleType":
    try:
        from wrongturn_agents.batch import whatif as core  # noqa: PLC0415 - needs the simulation
    except ImportError as error:
        raise RunError(
            f"whatif: drives in process, and {error.name} is not installed; install it with: "
            f"{install('wrongturn-service')}"
        ) from error
    return core


def _run_of(source: str, url: str | None) -> RunFile:
    """Return the run in a file, or a finished evaluation of a service."""
    if Path(source).exists():
        return RunFile.read(Path(source))
    with Client(url, patience=0) as client:
        return client.run_file(source)


def _agent_of(source: str, url: str | None, run: RunFile | None) -> str:
    """Return the name of the agent that drove. Raises RunError if no shipped agent has it."""
    found = None
    if run is not None:
        found = run.driver.name
    elif Path(source).exists():
        try:
            found = RunFile.read(Path(source)).driver.name
        except ValueError as error:
            raise RunError(f"--agent: {source} does not say who drove; name the agent") from error
    else:
        with Client(url, patience=0) as client:
            evaluation = client.episode(source).evaluation
            if evaluation is not None:
                found = client.agent(client.evaluation(evaluation).agent).name
    try:
        resolve(str(found))
    except AgentsError as error:
        raise RunError(f"--agent: no agent here is called {found!r}; name the one that drove") from error
    return str(found)


def _sweep_all(run: RunFile, asked: _Asked, every: float, progress: ProgressStyle) -> None:
    """Sweep the unsafe trials of a run, write each result as it comes, and print the table."""
    from wrongturn_agents.batch.workers import LocalWorkers  # noqa: PLC0415 - beside the core, which says what is missing

    core = _core()
    aside = asked.json_to == STDOUT
    file = None if aside else asked.json_to
    swept = SweepFile(agent=run.driver.name, evaluation=run.id, every=every).resumed(file)
    unsafe = [
        one
        for one in run.episodes
        if one.outcome.verdict.unsafe_strict and one.trajectory is not None and not is_twin(one.trajectory)
    ]
    left = [one for one in unsafe if one.trial not in swept.trials]
    folder = str(Path.cwd())
    tasks = (core.Sweep(asked.agent, folder, json.dumps(one.trajectory).encode(), every) for one in left)
    with show_progress(progress, run.driver.name) as update:
        update(len(unsafe) - len(left), len(unsafe))
        for _, result in LocalWorkers(asked.workers).drive(tasks, core.sweep):
            swept = swept.model_copy(update={"trials": {**swept.trials, result.trial: result}})
            write_json(swept.text(), file)
            update(len(swept.trials), len(unsafe))
    write_json(swept.text(), file)
    console(stderr=aside).print(sweep_table(run.driver.name, list(swept.trials.values())))
    if aside:
        sys.stdout.write(swept.text())


def is_twin(trajectory: dict[str, Any]) -> bool:
    """Return whether a trajectory is of a trial without a fault."""
    return bool(trajectory["fault"]["kind"] == "none")


def _give(result: ForkResult | SweepResult, posted: list[EpisodeDetail], json_to: Path | None) -> None:
    message = {**result.model_dump(mode="json"), "posted": [one.id for one in posted]}
    if not give_json(message, json_to):
        return
    if isinstance(result, SweepResult):
        console().print(sweep_table(result.trial, [result]))
    else:
        said = ROUTE if result.command is None else result.command.name
        typer.echo(f"{said} from {result.at:.1f} s on: {name(result.outcome.verdict)} at {result.outcome.time:.2f} s.")
        typer.echo(f"The stored drive: {'no verdict' if result.was is None else name(result.was)}.")
        typer.echo(
            "The agent acts the same."
            if result.reacts_s is None
            else f"It acts otherwise from {result.reacts_s:.1f} s on."
        )
        if result.differs is not None:
            typer.echo(str(result.differs))
    for one in posted:
        typer.echo(f"Driven at the service: {one.id}")


def sweep_table(title: str, results: list[SweepResult]) -> Table:
    """Return the points of no return and the detection times, a line for each trial."""
    table = plain_table(title)
    for head in ("trial", "verdict", "with the right command"):
        table.add_column(head, overflow="fold")
    for head in ("wrong from", "noticed at", "no return after"):
        table.add_column(head, justify="right")
    for one in sorted(results, key=lambda each: each.trial):
        verdicts = ["–" if verdict is None else name(verdict) for verdict in (one.verdict, one.right)]
        times = ["–" if at is None else f"{at:.1f} s" for at in (one.wrong_s, one.detection_s, one.no_return_s)]
        table.add_row(one.trial, *verdicts, *times)
    differing = [one.differs for one in results if one.differs is not None]
    table.caption = str(differing[0]) if differing else None
    return table


def _worth_posting(result: SweepResult) -> list[tuple[float, None]]:
    """Return the forks that show the point of no return: the last safe one, and the one a decision later."""
    at = result.no_return_s
    return [] if at is None else [(time, None) for time, _ in result.forks if at <= time < at + 1.5 * DECISION_S]


def _post(asked: _Asked, at: float, command: Command | None) -> EpisodeDetail:
    """Drive a fork at the service and return its episode."""
    found = resolve(asked.agent)
    with Client(asked.url) as client:
        begun = client.whatif(asked.source, at, command)
        try:
            drive_episode(client, GuardedAgent(found.name, found.make()), begun)
        except ApiError:
            client.abort_episode(begun.id)
            raise
        return client.episode(begun.id)
