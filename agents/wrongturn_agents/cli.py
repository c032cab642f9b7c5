"""``wrongturn run``: an agent's worker at the command line."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from wrongturn_agents.progress_style import ProgressStyle

if TYPE_CHECKING:
    from wrongturn_protocol import EvaluationDetail

DEFAULT_SUITE = "wrong-command@1"
_INTERRUPTED = 130


def run(
    agent: Annotated[
        str | None,
        typer.Argument(
            help="A registered name (see 'wrongturn agents'), package.module:Class, or an .onnx file.",
            show_default=False,
        ),
    ] = None,
    *,
    suite: Annotated[
        str | None, typer.Option(help=f"The suite of trials; {DEFAULT_SUITE} by default.", show_default=False)
    ] = None,
    url: Annotated[
        str | None,
        typer.Option(
            envvar="WRONGTURN_URL",
            help="The service; without it one is started for as long as the run lasts.",
            show_default=False,
        ),
    ] = None,
    name: Annotated[
        str | None,
        typer.Option(help="Name on the leaderboard; by default the agent's own.", show_default=False),
    ] = None,
    json_file: Annotated[
        Path | None,
        typer.Option("--json", metavar="FILE", help="Write the evaluation with its metrics.", show_default=False),
    ] = None,
    task: Annotated[
        str | None,
        typer.Option(
            help="This task's trials alone, as practice that is never ranked; goes on with what --json lacks.",
            show_default=False,
        ),
    ] = None,
    resume: Annotated[
        str | None,
        typer.Option(metavar="ID|FILE", help="Go on with a run that was interrupted.", show_default=False),
    ] = None,
    parallel: Annotated[
        int | None,
        typer.Option(
            min=1,
            help="Episodes at a time; by default one for each processor where the agent keeps no memory, else one.",
            show_default=False,
        ),
    ] = None,
    progress: Annotated[
        ProgressStyle,
        typer.Option(help="How to tell the progress, on stderr: a bar, lines, or JSON lines for a program."),
    ] = ProgressStyle.AUTO,
) -> None:
    """Drive an agent through a suite and print the table in the paper's layout; of journeys in CoRL 2017's.

    WRONGTURN_TOKEN: the token of an agent that is registered already.

    WRONGTURN_OPERATOR_TOKEN: registers a baseline as one.
    """
    import traceback  # noqa: PLC0415 - the program starts quickly without what only this command needs

    from wrongturn_agents.errors import AgentFailedError  # noqa: PLC0415
    from wrongturn_client.tables import console, evaluation_table  # noqa: PLC0415

    try:
        if task is not None:
            _run_task(agent, task, suite, url, json_file, parallel, progress, unused=(name, resume))
            return
        shown, evaluation = _run(
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
        if error.__cause__ is not None:  # it is the user's own program: show where it broke
            traceback.print_exception(error.__cause__)
        raise
    except KeyboardInterrupt:
        raise typer.Exit(_INTERRUPTED) from None
    if evaluation.metrics is not None:
        console().print(evaluation_table(shown, evaluation.metrics))


def _run_task(
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
    """Drive a task's trials, and tell how many of them came to what."""
    from collections import Counter  # noqa: PLC0415
    from dataclasses import replace  # noqa: PLC0415

    from wrongturn_agents.errors import RunError  # noqa: PLC0415
    from wrongturn_agents.practice_run import PracticeRun  # noqa: PLC0415
    from wrongturn_agents.progress import report  # noqa: PLC0415
    from wrongturn_agents.registry import resolve  # noqa: PLC0415
    from wrongturn_agents.suites import installed_suite  # noqa: PLC0415
    from wrongturn_agents.worker import service_at, side_by_side  # noqa: PLC0415
    from wrongturn_client import settings  # noqa: PLC0415

    if agent is None:
        raise RunError("AGENT: name one; 'wrongturn agents' lists the shipped ones")
    if json_file is None:
        raise RunError("--json: give it with --task: nothing else would keep what the trials came to")
    if any(value is not None for value in unused):
        raise RunError("--task: its trials are practice; leave --name and --resume out")
    source = resolve(agent)
    made = source.make()
    source = replace(source, make=lambda: made)
    parallel = side_by_side(made, parallel)
    driven = PracticeRun(source, installed_suite(suite or "navigation@1"), task, json_file)
    token = settings.token() if url is not None else None
    with service_at(url, None) as (at, _), report(progress, source.name) as told:
        results = driven.drive(at, token, told, parallel=parallel)
    counts = Counter(result.verdict for result in results.trials.values())
    typer.echo(f"{task}: " + ", ".join(f"{verdict} {count}" for verdict, count in counts.most_common()))


def _run(
    agent: str | None,
    *,
    suite: str | None,
    url: str | None,
    name: str | None,
    json_file: Path | None,
    resume: str | None,
    parallel: int | None,
    progress: ProgressStyle,
) -> tuple[str, "EvaluationDetail"]:
    """Run it; gives the agent's name on the leaderboard and the finished evaluation."""
    import os  # noqa: PLC0415
    from dataclasses import replace  # noqa: PLC0415

    from wrongturn_agents.errors import RunError  # noqa: PLC0415
    from wrongturn_agents.progress import report  # noqa: PLC0415
    from wrongturn_agents.registry import resolve  # noqa: PLC0415
    from wrongturn_agents.saved_run import SavedRun  # noqa: PLC0415
    from wrongturn_agents.suites import installed_suite  # noqa: PLC0415
    from wrongturn_agents.worker import OPERATOR_TOKEN, RunRequest, begin, drive, service_at, side_by_side  # noqa: PLC0415
    from wrongturn_client import settings  # noqa: PLC0415
    from wrongturn_client.invocation import program  # noqa: PLC0415

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
        raise RunError("AGENT: name one, or a run to go on with by --resume; 'wrongturn agents' lists the shipped ones")
    suite = suite or DEFAULT_SUITE
    source = resolve(agent)
    if saved_run is None and url is None:
        installed_suite(suite)  # a service that is started here has those that are installed; another may have others
    made = source.make()  # what cannot be made takes no name and begins no evaluation
    source = replace(source, make=lambda: made)
    parallel = side_by_side(made, parallel)
    token = settings.token() if url is not None else None
    if saved_run is None and token is not None and name is not None:
        raise RunError("--name: WRONGTURN_TOKEN is the token of an agent that has its name; leave out one of the two")
    with service_at(url, os.environ.get(OPERATOR_TOKEN) or None) as (at, operator_token):
        if saved_run is None:
            request = RunRequest(agent=agent, suite=suite, url=url, name=name, token=token)
            saved_run = begin(request, source, at, operator_token)
        shown = saved_run.name or source.name
        typer.echo(f"{shown} on {suite} at {at}: evaluation {saved_run.evaluation}", err=True)
        try:
            with report(progress, shown) as told:
                evaluation = drive(saved_run, source, at, told, parallel=parallel)
        except BaseException:
            typer.echo(f"Not finished. To go on with it: {program()} run --resume {saved_run.evaluation}", err=True)
            raise
    if json_file is not None:
        try:
            json_file.write_text(evaluation.model_dump_json(indent=2) + "\n", encoding="utf-8")
        except OSError as error:
            raise RunError(
                f"--json: {json_file} cannot be written ({error.strerror}); the run is finished: "
                f"'{program()} run --resume {saved_run.evaluation} --json FILE' writes it elsewhere",
            ) from error
    return shown, evaluation
