"""One evaluation of ``wrongturn run``: begun or resumed, driven to its end, and written to a file."""

import shlex
import sys
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import typer

from wrongturn_agents.agent import try_out
from wrongturn_agents.errors import RunError, RunOverError
from wrongturn_agents.progress import ProgressStyle, show_progress
from wrongturn_agents.registry import ZIP, AgentSource, resolve, with_absolute_file
from wrongturn_agents.saved_run import RunDatabase, SavedRun
from wrongturn_agents.suites import UNSEEN, sha256_of_suite
from wrongturn_agents.worker import GuardedAgent, begin, drive, episodes_side_by_side, service_at
from wrongturn_client import Client, WrongturnError, settings
from wrongturn_client.evaluation import run_lines
from wrongturn_client.invocation import program
from wrongturn_client.settings import OPERATOR_TOKEN, OWNER_TOKEN
from wrongturn_client.tables import standing
from wrongturn_protocol import EvaluationDetail
from wrongturn_protocol.json_output import STDOUT, check_json_file


@dataclass(frozen=True)
class RunOptions:
    """What the user asks for, as the options of the same names."""

    agent: str | None = None
    suite: str | None = None
    url: str | None = None
    name: str | None = None
    json_file: Path | None = None
    resume: str | None = None
    parallel: int | None = None
    progress: ProgressStyle = ProgressStyle.AUTO
    keep: bool = False


@dataclass(frozen=True)
class Done:
    """A finished run."""

    name: str
    """The agent's name on the leaderboard."""
    evaluation: EvaluationDetail
    place: str | None
    """A sentence about its place; None if the service does not say."""
    unsaved: RunError | None
    """Why the file of ``--json`` was not written; None if it was, or none was asked for."""


def evaluate(options: RunOptions) -> Done:
    """Begin or resume an evaluation, drive it, and write its file.

    Without a URL, the run starts a service of its own. It deletes that service's database at
    the end. An interrupted run keeps the database, so that you can resume it.

    Raises:
        RunError: An option does not fit the others, or the run cannot begin.
    """
    check_json_file(options.json_file)
    saved_run = None if options.resume is None else _resumed(options.resume, options)
    agent, suite, url = _chosen(options, saved_run)
    if options.keep and url is not None:
        raise RunError(f"--keep: {url} keeps its own database; leave --keep out")
    if saved_run is None and url is None:
        # The service that is started has the installed suites; another service may have others.
        sha256_of_suite(suite)
    source, parallel = made_once(agent, options.parallel)
    if saved_run is not None:
        _say_what_changed(saved_run, source)
    with ExitStack() as stack:
        kept = None if saved_run is None else saved_run.database
        database = None if url is not None else stack.enter_context(RunDatabase(kept))
        started = service_at(url, settings.secret(OPERATOR_TOKEN), None if database is None else database.url)
        at, operator_token = stack.enter_context(started)
        if saved_run is None:
            # The user's tokens are for a service that stays, not for the run's own.
            token, owner_token = (None, None) if url is None else _tokens(options)
            saved_run = begin(
                agent,
                suite,
                source,
                at,
                operator_token=operator_token,
                name=options.name,
                token=token,
                owner_token=owner_token,
            )
            if database is not None:
                database.needed = True
                own = {"url": None, "database": database.folder, "keep": options.keep}
                saved_run = saved_run.model_copy(update=own)
                saved_run.save()
        elif options.keep and not saved_run.keep:
            saved_run = saved_run.model_copy(update={"keep": True})
            saved_run.save()
        try:
            done = _driven(saved_run, source, at, parallel, options)
        except RunOverError:
            if database is not None:
                database.needed = False
                saved_run.forget()
            raise
        if database is not None:
            _keep_or_forget(saved_run, database, done)
    return done


def made_once(agent: str, parallel: int | None) -> tuple[AgentSource, int]:
    """Find and make the agent, so that one that cannot be made takes no name and begins no evaluation.

    Return the source of this one agent, and the number of episodes that it drives at once.
    """
    if agent.endswith(ZIP) and Path(agent).is_file():
        typer.echo(f"Loading {agent} runs code that is named inside: run only files that you trust.", err=True)
    source = resolve(agent)
    made = source.make()
    if agent.endswith(ZIP) or source.rig is not None:  # other people's models: a wrong shape is named here
        try_out(GuardedAgent(source.name, made), source.sight)
    return replace(source, make=lambda: made), episodes_side_by_side(made, parallel)


def _resumed(resume: str, options: RunOptions) -> SavedRun:
    """Return the run to resume, after a check that no option is about another one."""
    saved_run = SavedRun.load(resume)
    agent = options.agent
    if agent is not None and with_absolute_file(agent) != saved_run.agent:
        raise RunError(f"AGENT: that run is of {saved_run.agent}, not of {agent}; leave AGENT out with --resume")
    if options.name is not None:
        raise RunError("--name: that run has its name already; leave --name out with --resume")
    if options.suite is not None:
        raise RunError(f"--suite: that run is on {saved_run.suite} already; leave --suite out with --resume")
    return saved_run


def _chosen(options: RunOptions, saved_run: SavedRun | None) -> tuple[str, str, str | None]:
    """Return the agent, the suite and the service's URL."""
    if saved_run is not None:
        # Only a service of the run's own has its evaluation.
        url = None if saved_run.url is None else options.url or saved_run.url
        return saved_run.agent, saved_run.suite, url
    if options.agent is None:
        raise RunError("AGENT: name one, or a run to resume with --resume; 'wrongturn agents' lists the shipped ones")
    return options.agent, options.suite or UNSEEN, options.url


def _tokens(options: RunOptions) -> tuple[str | None, str | None]:
    """Return the user's tokens: of an agent, or else of the owner of a new agent."""
    token = settings.token()
    if token is not None and options.name is not None:
        raise RunError("--name: the agent of WRONGTURN_TOKEN has a name already; leave out one of the two")
    return token, settings.secret(OWNER_TOKEN) if token is None else None


def _say_what_changed(saved_run: SavedRun, source: AgentSource) -> None:
    """Warn that another agent drives the rest of a run."""
    if files := saved_run.changed(source.code):
        typer.echo(
            f"The agent's code has changed since this run began: {', '.join(files)}. The new code drives the rest, "
            "so the results are of both. A changed agent is a new agent: begin a new run for it.",
            err=True,
        )


def _driven(saved_run: SavedRun, source: AgentSource, at: str, parallel: int, options: RunOptions) -> Done:
    """Drive a run to its end, and write its file."""
    shown = saved_run.name or source.name
    typer.echo(f"{shown} on {saved_run.suite} at {at}: evaluation {saved_run.evaluation}", err=True)
    try:
        with show_progress(options.progress, shown) as update:
            evaluation = drive(saved_run, source, at, update, parallel=parallel)
        place = _place(at, evaluation, own=saved_run.database is not None)
    except RunOverError:
        raise
    except BaseException:
        typer.echo(f"Not finished. To go on with it: {program()} run --resume {saved_run.evaluation}", err=True)
        raise
    unsaved = None if options.json_file is None else _save(at, saved_run.evaluation, options.json_file)
    return Done(shown, evaluation, place, unsaved)


def _place(at: str, evaluation: EvaluationDetail, *, own: bool) -> str | None:
    """Return a sentence about an evaluation's place on the leaderboard, or None if it cannot be had.

    On a run's own service, which has no other agents, it says whether the agent would be ranked.
    """
    if evaluation.metrics is None:
        return None
    try:
        with Client(at) as client:
            return standing(client.leaderboard(evaluation.suite), evaluation.id, alone=own)
    except WrongturnError:
        return None  # the run is finished and its results are there: no place is no failure


def _save(at: str, evaluation: str, file: Path) -> RunError | None:
    """Write a finished evaluation into a file; return the error if that fails, since the run itself did not."""
    try:
        with Client(at, "") as client:  # a finished evaluation is public
            if file == STDOUT:
                sys.stdout.buffer.writelines(run_lines(client, evaluation))
                sys.stdout.buffer.flush()
            else:
                client.save_run(evaluation, file)
    except BrokenPipeError:
        raise  # the reader of the pipe is gone, and wants no message
    except (OSError, WrongturnError) as error:
        reason = (error.strerror or error) if isinstance(error, OSError) else error
        return RunError(
            f"--json: {file} cannot be written ({reason}); the run is finished: "
            f"'{program()} run --resume {evaluation} --json FILE' writes it"
        )
    return None


def _keep_or_forget(saved_run: SavedRun, database: RunDatabase, done: Done) -> None:
    """Let the database of a finished run go, unless the user keeps it or the run's file is still to be written."""
    if saved_run.keep:
        serve = f"{program()} serve --database {shlex.quote(database.url)}"
        typer.echo(f"The run's database is kept. To look at it: {serve}", err=True)
    elif done.unsaved is None:
        database.needed = False
        saved_run.forget()
