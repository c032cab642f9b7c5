"""``wrongturn run``: drive an agent from the command line."""

import traceback
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer

from wrongturn_agents.errors import AgentFailedError, RunError, RunOverError
from wrongturn_agents.practice_run import PracticeRun
from wrongturn_agents.progress import ProgressStyle, show_progress
from wrongturn_agents.registry import AgentSource, resolve
from wrongturn_agents.saved_run import SavedRun
from wrongturn_agents.suites import NAVIGATION, WRONG_COMMAND, installed_suite
from wrongturn_agents.worker import (
    OPERATOR_TOKEN,
    RunRequest,
    begin,
    check_current,
    drive,
    episodes_side_by_side,
    service_at,
)
from wrongturn_client import Client, WrongturnError, settings
from wrongturn_client.invocation import program
from wrongturn_client.settings import OWNER_TOKEN
from wrongturn_client.tables import console, evaluation_table, standing
from wrongturn_protocol import EvaluationDetail

_INTERRUPTED = 130


@dataclass(frozen=True)
class _Done:
    """A finished run."""

    name: str
    """The agent's name on the leaderboard."""
    evaluation: EvaluationDetail
    place: str | None
    """A sentence about its place; None if the service does not say."""
    unsaved: RunError | None
    """Why the file of ``--json`` was not written; None if it was, or none was asked for."""


def run(
    agent: Annotated[
        str | None,
        typer.Argument(
            help="A name that 'wrongturn agents' lists, package.module:Class, or an .onnx file. Example: careful"
        ),
    ] = None,
    *,
    suite: Annotated[str | None, typer.Option(help=f"Suite of trials; by default {WRONG_COMMAND}.")] = None,
    url: Annotated[
        str | None,
        typer.Option(
            envvar="WRONGTURN_URL",
            help="Service to use; by default one is started for this run. Example: --url http://127.0.0.1:8000",
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(help="Name on the leaderboard; by default the agent's own."),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json",
            metavar="FILE",
            help="File for the evaluation with every outcome and trajectory; compressed if it ends in .gz. "
            "Example: run.json.gz",
        ),
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(
            help="Drive only this task's trials, as practice that is never ranked. Leaves out what the file of --json "
            "already has. Example: --task navigation_dynamic"
        ),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(metavar="ID|FILE", help="Resume an interrupted run, by the id of its evaluation or its file."),
    ] = None,
    parallel: Annotated[
        int | None,
        typer.Option(
            min=1, help="Episodes at once; by default one for each processor if the agent keeps no memory, else one."
        ),
    ] = None,
    progress: Annotated[
        ProgressStyle,
        typer.Option(help="How to show progress on stderr: a bar, lines, or JSON lines for a program."),
    ] = ProgressStyle.AUTO,
) -> None:
    """Drive an agent through a suite and print its results in the layout of the paper, or of CoRL 2017 for journeys.

    Example: wrongturn run careful --suite smoke@2

    WRONGTURN_TOKEN: the token of your agent, if you have registered it already.

    WRONGTURN_OWNER_TOKEN: the token of the owner whose agent it becomes. Example: export WRONGTURN_OWNER_TOKEN=wt_…

    WRONGTURN_OPERATOR_TOKEN: the operator's token. With it, baselines are registered as baselines.

    Each of these can be in a file instead. Example: export WRONGTURN_TOKEN_FILE=tokens/careful/token
    """
    try:
        if task is not None:
            _practise(agent, task, suite, url, json_file, parallel, progress, unused=(name, resume))
            return
        done = _evaluate(
            agent,
            suite=suite,
            url=url,
            name=name,
            json_file=json_file,
            resume=resume,
            parallel=parallel,
            progress=progress,
        )
    except AgentFailedError as error:
        if error.__cause__ is not None:  # the error is in the user's program: show where
            traceback.print_exception(error.__cause__)
        raise
    except KeyboardInterrupt:
        raise typer.Exit(_INTERRUPTED) from None
    if done.evaluation.metrics is not None:
        console().print(evaluation_table(done.name, done.evaluation.metrics))
    if done.place is not None:
        typer.echo(done.place)
    if done.unsaved is not None:
        raise done.unsaved


def _practise(
    agent: str | None,
    task: str,
    suite: str | None,
    url: str | None,
    json_file: Path | None,
    parallel: int | None,
    progress: ProgressStyle,
    *,
    unused: tuple[str | None, ...],
) -> None:
    """Drive a task's trials and print how many of them had which verdict."""
    if agent is None:
        raise RunError("AGENT: name one; 'wrongturn agents' lists the shipped ones")
    if json_file is None:
        raise RunError("--json: give it with --task: nothing else would keep the results")
    if any(value is not None for value in unused):
        raise RunError("--task: its trials are practice; leave --name and --resume out")
    source, parallel = _made_once(agent, parallel)
    practice_run = PracticeRun(source, installed_suite(suite or NAVIGATION), task, json_file)
    token = settings.token() if url is not None else None
    with service_at(url, None) as (at, _), show_progress(progress, source.name) as update:
        results = practice_run.drive(at, token, update, parallel=parallel)
    counts = Counter(result.verdict for result in results.trials.values())
    typer.echo(f"{task}: " + ", ".join(f"{verdict} {count}" for verdict, count in counts.most_common()))


def _evaluate(
    agent: str | None,
    *,
    suite: str | None,
    url: str | None,
    name: str | None,
    json_file: Path | None,
    resume: str | None,
    parallel: int | None,
    progress: ProgressStyle,
) -> _Done:
    """Begin or resume an evaluation, drive it, and write its file."""
    saved_run: SavedRun | None = None
    if json_file is not None and (json_file.is_dir() or not json_file.absolute().parent.is_dir()):
        raise RunError(f"--json: {json_file} cannot be written; name a file in a directory that exists")
    if resume is not None:
        saved_run = SavedRun.load(resume)
        if agent is not None and agent != saved_run.agent:
            raise RunError(f"AGENT: that run is of {saved_run.agent}, not of {agent}; leave AGENT out with --resume")
        if name is not None:
            raise RunError("--name: that run has its name already; leave --name out with --resume")
        if suite is not None:
            raise RunError(f"--suite: that run is on {saved_run.suite} already; leave --suite out with --resume")
        agent, suite, url = saved_run.agent, saved_run.suite, url or saved_run.url
    if agent is None:
        raise RunError("AGENT: name one, or a run to resume with --resume; 'wrongturn agents' lists the shipped ones")
    suite = suite or WRONG_COMMAND
    if saved_run is None and url is None:
        # The service that is started has the installed suites; another service may have others.
        check_current(suite, installed_suite(suite).successor)
    source, parallel = _made_once(agent, parallel)
    token = settings.token() if url is not None else None
    owner_token = settings.secret(OWNER_TOKEN) if url is not None and token is None else None
    if saved_run is None and token is not None and name is not None:
        raise RunError("--name: WRONGTURN_TOKEN is the token of an agent that has its name; leave out one of the two")
    with service_at(url, settings.secret(OPERATOR_TOKEN)) as (at, operator_token):
        if saved_run is None:
            request = RunRequest(agent=agent, suite=suite, url=url, name=name, token=token, owner_token=owner_token)
            saved_run = begin(request, source, at, operator_token)
        shown = saved_run.name or source.name
        typer.echo(f"{shown} on {suite} at {at}: evaluation {saved_run.evaluation}", err=True)
        try:
            with show_progress(progress, shown) as update:
                evaluation = drive(saved_run, source, at, update, parallel=parallel)
            place = _place(at, evaluation)
        except RunOverError:
            raise
        except BaseException:
            typer.echo(f"Not finished. To go on with it: {program()} run --resume {saved_run.evaluation}", err=True)
            raise
        unsaved = None if json_file is None else _save(at, saved_run.evaluation, json_file)
    return _Done(shown, evaluation, place, unsaved)


def _save(at: str, evaluation: str, file: Path) -> RunError | None:
    """Write a finished evaluation into a file; return the error if that fails, since the run itself did not."""
    try:
        with Client(at, "") as client:  # a finished evaluation is public
            client.save_run(evaluation, file)
    except (OSError, WrongturnError) as error:
        reason = (error.strerror or error) if isinstance(error, OSError) else error
        return RunError(
            f"--json: {file} cannot be written ({reason}); the run is finished: "
            f"'{program()} run --resume {evaluation} --json FILE' writes it",
        )
    return None


def _place(at: str, evaluation: EvaluationDetail) -> str | None:
    """Return a sentence about an evaluation's place on the leaderboard, or None if it cannot be had."""
    if evaluation.metrics is None:
        return None
    try:
        with Client(at) as client:
            return standing(client.leaderboard(evaluation.suite), evaluation.id)
    except WrongturnError:
        return None  # the run is finished and its results are there: no place is no failure


def _made_once(agent: str, parallel: int | None) -> tuple[AgentSource, int]:
    """Find and make the agent, so that one that cannot be made takes no name and begins no evaluation.

    Returns:
        The source of this one agent, and the number of episodes that it drives at once.
    """
    source = resolve(agent)
    made = source.make()
    return replace(source, make=lambda: made), episodes_side_by_side(made, parallel)
