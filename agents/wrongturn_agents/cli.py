"""``wrongturn run``: drive an agent from the command line."""

import sys
import traceback
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from wrongturn_agents.batch_options import MOST_DRAWS, BatchOptions, drive_batch
from wrongturn_agents.errors import AgentFailedError, RunError
from wrongturn_agents.evaluation_run import RunOptions, evaluate, made_once
from wrongturn_agents.practice import PracticeRun, practice_table
from wrongturn_agents.progress import ProgressStyle, show_progress
from wrongturn_agents.saved_run import RunDatabase
from wrongturn_agents.suites import NAVIGATION, UNSEEN, WRONG_COMMAND, installed_suite, suite_named
from wrongturn_agents.worker import service_at
from wrongturn_client import settings
from wrongturn_client.tables import console, print_metrics
from wrongturn_protocol.json_output import STDOUT, check_json_file

_INTERRUPTED = 130


def run(
    agents: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[AGENT]...",
            help="A name that 'wrongturn agents' lists, package.module:Class, an .onnx file, or a .zip file of "
            "Stable-Baselines3, whose code runs; several with --workers or --ray. Example: careful",
        ),
    ] = None,
    *,
    suite: Annotated[
        str | None, typer.Option(help=f"Suite of trials, or its file; by default {UNSEEN}. Example: --suite smoke@3")
    ] = None,
    url: Annotated[
        str | None,
        typer.Option(
            envvar="WRONGTURN_URL",
            help="Service to use; by default one is started for this run, and its database is deleted. "
            "Example: --url http://127.0.0.1:8000",
        ),
    ] = None,
    name: Annotated[
        str | None, typer.Option(help="Name on the leaderboard; by default the agent's own. Example: --name 'slow 2'")
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json",
            metavar="[FILE]",
            help="Print only JSON; with FILE, print as usual and write the JSON there. It has each trial's outcome and "
            "trajectory; in practice, each trial's verdict. A FILE that ends in .gz is compressed. "
            "Example: --json run.json.gz",
        ),
    ] = None,
    practice: Annotated[
        bool,
        typer.Option(
            "--practice",
            help="Drive the suite as practice, which is never scored. A suite that draws its trials uses the open "
            "draw. Trials that the file of --json already has are left out.",
        ),
    ] = False,
    task: Annotated[
        str | None, typer.Option(help="Practise only this task's trials. Example: --task navigation_dynamic")
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(
            metavar="ID|FILE",
            help="Resume an interrupted run, by the id of its evaluation or its file. Example: --resume ev_1a2b3c",
        ),
    ] = None,
    keep: Annotated[
        bool, typer.Option("--keep", help="Keep the database of the service that is started for this run.")
    ] = False,
    parallel: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Episodes at once; by default one for each processor if the agent keeps no memory, else one. "
            "Example: --parallel 4",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            min=1, help="Practise without a service, in so many processes of this machine. Example: --workers 4"
        ),
    ] = None,
    ray: Annotated[
        bool,
        typer.Option(
            "--ray", help="Practise without a service, on the Ray cluster that RAY_ADDRESS names, or a new one."
        ),
    ] = False,
    draws: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=MOST_DRAWS,
            help="With --workers or --ray: drive the open draw and so many public draws in all. Example: --draws 10",
        ),
    ] = None,
    shard: Annotated[
        str | None,
        typer.Option(
            metavar="I/N",
            help="With --workers or --ray: drive the I-th of N pieces. 'wrongturn results --merge' joins their files. "
            "Example: --shard 2/10",
        ),
    ] = None,
    progress: Annotated[
        ProgressStyle,
        typer.Option(
            help="How to show progress on stderr: a bar, lines, or JSON lines for a program. Example: --progress json"
        ),
    ] = ProgressStyle.AUTO,
) -> None:
    """Drive an agent through a suite and print its results in the layout of the paper, or of CoRL 2017 for journeys.

    Example: wrongturn run careful --suite smoke@3

    WRONGTURN_TOKEN: the token of your agent, if you have registered it already.

    WRONGTURN_OWNER_TOKEN: the token of the owner to whom the new agent will belong.
    Example: export WRONGTURN_OWNER_TOKEN=wt_…

    WRONGTURN_OPERATOR_TOKEN: the operator's token. With it, baselines are registered as baselines.

    Each of these can be in a file instead. Example: export WRONGTURN_TOKEN_FILE=tokens/careful/token
    """
    agent = agents[0] if agents else None
    suite = suite if suite is None else suite_named(suite)
    options = RunOptions(agent, suite, url, name, json_file, resume, parallel, progress, keep)
    batch = BatchOptions(agents or (), draws, workers, ray, shard, task)
    try:
        if batch.wanted:
            drive_batch(options, batch)
        elif practice or task is not None:
            _practise(options, task)
        else:
            _evaluate(options)
    except AgentFailedError as error:
        if error.__cause__ is not None:  # the error is in the user's program: show where
            traceback.print_exception(error.__cause__)
        raise
    except KeyboardInterrupt:
        raise typer.Exit(_INTERRUPTED) from None


def _evaluate(options: RunOptions) -> None:
    """Drive an evaluation and print its results; on stderr if stdout has the JSON."""
    done = evaluate(options)
    aside = options.json_file == STDOUT
    if done.evaluation.metrics is not None:
        print_metrics(console(stderr=aside), done.name, done.evaluation.metrics)
    if done.place is not None:
        typer.echo(done.place, err=aside)
    if done.unsaved is not None:
        raise done.unsaved


def _practise(options: RunOptions, task: str | None) -> None:
    """Drive a suite's trials, or a task's, and print a summary; on stderr if stdout has the JSON."""
    if options.agent is None:
        raise RunError("AGENT: name one; 'wrongturn agents' lists the shipped ones")
    for option, given in (("--name", options.name), ("--resume", options.resume), ("--keep", options.keep)):
        if given:
            raise RunError(f"{option}: practice keeps nothing but the file of --json; leave {option} out")
    check_json_file(options.json_file)
    suite = installed_suite(options.suite or (WRONG_COMMAND if task is None else NAVIGATION))
    source, parallel = made_once(options.agent, options.parallel)
    aside = options.json_file == STDOUT
    run = PracticeRun(source, suite, task, None if aside else options.json_file)
    token = settings.token() if options.url is not None else None
    with ExitStack() as stack:
        database = None if options.url is not None else stack.enter_context(RunDatabase()).url
        at, _ = stack.enter_context(service_at(options.url, None, database))
        try:
            with show_progress(options.progress, source.name) as update:
                results = run.drive(at, token, update, parallel=parallel)
        except KeyboardInterrupt:
            if options.json_file is not None and not aside:
                typer.echo(f"Not finished. The same command goes on with what {options.json_file} has.", err=True)
            raise
    console(stderr=aside).print(practice_table(results, suite))
    if aside:
        sys.stdout.write(results.text())
