"""``wrongturn results``: the paper's tables from the stored results, with our figures beside the paper's."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.registry import list_agents
from wrongturn_agents.reporting.collection import STORED
from wrongturn_agents.reporting.curve_pictures import check_pictures, draw_pictures
from wrongturn_agents.reporting.failures import FILMS, check_films
from wrongturn_agents.reporting.figures_cli import Format, Wanted, Width, make
from wrongturn_agents.reporting.importing import Overrides, import_results
from wrongturn_agents.reporting.making_evaluations import make_evaluations
from wrongturn_agents.reporting.making_failures import make_failures
from wrongturn_agents.reporting.making_studies import make_draws, make_judgings
from wrongturn_agents.reporting.order import order_in_words
from wrongturn_agents.reporting.report import Report, check_page, find_pages, write_page
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_client.tables import console
from wrongturn_protocol.json_output import STDOUT, JsonTo, check_json_file, give_json
from wrongturn_protocol.suggestions import did_you_mean


def results(
    runs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[RUN]...",
            help="For --figures, --latex and --csv: files of 'wrongturn run --json', or names of agents with results, "
            "stored or on a service (--url). NAME=RUN shows it under another name. By default all shipped agents. "
            "Example: run.json.gz",
        ),
    ] = None,
    *,
    directory: Annotated[
        Path | None,
        typer.Option(
            metavar="DIRECTORY",
            help="Directory of the results; by default the package's own. Example: --directory my-results",
        ),
    ] = None,
    json_to: JsonTo = None,
    write: Annotated[
        list[Path] | None,
        typer.Option(metavar="PAGE", help="Write the tables into a page. Example: --write docs/results.md"),
    ] = None,
    check: Annotated[
        bool,
        typer.Option(
            "--check", help="Fail if a page or a picture of the curves differs from the stored results. Writes nothing."
        ),
    ] = False,
    curves: Annotated[bool, typer.Option("--curves", help="Draw the learning curves into docs/pictures.")] = False,
    sources: Annotated[
        list[Path] | None,
        typer.Option(
            "--import",
            metavar="FILE|RUN",
            help="Store a file of 'wrongturn score --json' or 'wrongturn run --json', or the learning curve of a "
            "training run. Example: --import runs/ppo-image-3",
        ),
    ] = None,
    sensitivity: Annotated[
        bool,
        typer.Option(
            "--sensitivity",
            help="Drive the agents on past their verdicts, judge the drives by other thresholds and by version 1, and "
            "store what changes. Takes minutes for each agent; goes on where it stopped.",
        ),
    ] = False,
    failures: Annotated[
        bool,
        typer.Option(
            "--failures",
            help="Drive the learned agents' unsafe trials again, measure what they do, and make the films of "
            "docs/failures.md. Takes minutes for each agent; goes on where it stopped.",
        ),
    ] = False,
    draws: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Drive the agents through N draws, and store how their counts vary. Takes minutes for each draw; goes "
            "on where it stopped. Example: --draws 10",
            min=2,
        ),
    ] = None,
    evaluations: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Drive N evaluations of each --agent over services of their own, and store how they ended. Takes "
            "minutes for each; goes on where it stopped. Example: --evaluations 10",
            min=1,
        ),
    ] = None,
    agent: Annotated[
        list[str] | None,
        typer.Option(
            help="Agent of the import, which replaces the one in the file; or an agent to drive for --evaluations, and "
            "for --sensitivity, --draws and --failures, there all by default. Give it again for another, or put commas "
            "between names. Example: --agent ppo-image"
        ),
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Training seed of the import. Example: --seed 3", min=0)] = None,
    variant: Annotated[
        str | None, typer.Option(help="Ablation of the import. Example: --variant without-augmentation")
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(help="Training steps of the import. Example: --steps 2000000", min=0),
    ] = None,
    figures: Annotated[
        Path | None,
        typer.Option(
            "--figures",
            metavar="FOLDER",
            help="Draw unsafe rates, pairs of trial and twin, and the trajectories of run files. Example: --figures "
            "paper/figures run.json.gz",
        ),
    ] = None,
    latex: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Write the paper's table of the runs for LaTeX (booktabs); - prints it. Example: --latex table.tex",
        ),
    ] = None,
    csv: Annotated[
        Path | None,
        typer.Option(
            "--csv",
            metavar="FILE",
            help="Write a row for each trial and twin; - prints them. Example: --csv trials.csv",
        ),
    ] = None,
    width: Annotated[
        Width, typer.Option(help="Width of the figures: one column of a paper, or the page. Example: --width page")
    ] = Width.COLUMN,
    formats: Annotated[
        list[Format] | None,
        typer.Option("--format", help="Format of the figures; give it again for another. Example: --format svg"),
    ] = None,
    paper: Annotated[bool, typer.Option("--paper", help="Put the paper's agents first in the LaTeX table.")] = False,
    url: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Service with the agents and towns. Example: --url http://127.0.0.1:8000"),
    ] = None,
    suite: Annotated[
        str, typer.Option(help="Suite of the agents that you name without a file. Example: --suite smoke@2")
    ] = WRONG_COMMAND,
) -> None:
    """Show the tables of results: ours beside the paper's, with their spread over training seeds.

    Example: wrongturn results --check

    For a paper: wrongturn results --figures figures --latex table.tex --csv trials.csv run.json.gz
    """
    check_json_file(json_to)
    directory = STORED if directory is None else directory
    if figures is not None or latex is not None or csv is not None:
        if any((json_to, write, check, curves, sources, sensitivity, failures, draws, evaluations)):
            raise ResultsError("--figures, --latex, --csv: they are of runs; run the command once more for the rest")
        kinds = formats or [Format.PDF, Format.PNG]
        make(Wanted(runs or [], directory, url, suite, figures, latex, csv, width, kinds, paper))
        return
    if runs:
        raise ResultsError(f"RUN: {runs[0]}: say what to make of it by --figures, --latex or --csv")
    studied = sensitivity or failures or draws is not None or evaluations is not None
    if not sources and any(value is not None for value in (None if studied else agent, seed, variant, steps)):
        raise ResultsError(
            "--agent, --seed, --variant, --steps: they describe an import; give --import too. --agent also names what "
            "to drive for --sensitivity, --draws, --evaluations and --failures"
        )
    if sources and studied:
        raise ResultsError(
            "--import: cannot go with --sensitivity, --draws, --evaluations, --failures; run the command once for each"
        )
    agents = [name.strip() for names in agent or () for name in names.split(",") if name.strip()]
    if agent and not agents:
        raise ResultsError("--agent: names no agent. Example: --agent ppo-image")
    if sources and len(agents) > 1:
        raise ResultsError(f"--agent: an import is of one agent; name one of {', '.join(agents)}")
    for source in sources or ():
        overrides = Overrides(agents[0] if agents else None, seed, variant, steps)
        before = set(directory.rglob("*"))
        stored = import_results(source, directory, overrides)
        typer.echo(f"{source}: stored as {stored.name}{_noted(stored, before, overrides.agent)}", err=True)
    if sensitivity:
        typer.echo(f"stored as {make_judgings(directory, agents)}", err=True)
    if draws is not None:
        typer.echo(f"stored as {make_draws(directory, agents, draws)}", err=True)
    if evaluations is not None:
        typer.echo(f"stored in {make_evaluations(directory, agents, evaluations)}", err=True)
    if failures:
        typer.echo(f"stored as {make_failures(directory, agents)}", err=True)
    report = Report.read(directory)
    if check:
        _check(report, write)
        return
    if curves:
        for picture in draw_pictures(report.curves):
            typer.echo(f"{picture}: drawn", err=True)
    for page in write or ():
        typer.echo(f"{page}: {'written' if write_page(page, report) else 'unchanged'}", err=True)
    if json_to is not None:
        give_json(report.as_json(), json_to)
    if json_to == STDOUT:
        return
    if studied:
        shown = {"sensitivity": sensitivity, "versions": sensitivity, "draws": draws, "evaluations": evaluations}
        _print_tables(report, (name for name, driven in shown.items() if driven))
    elif not (curves or write or sources):
        _print(report)


def _check(report: Report, named: list[Path] | None) -> None:
    """Check the named pages, or all pages and the pictures."""
    pages = named or find_pages(Path())
    if not pages:
        raise ResultsError(
            "--check: no page with results here; go to the repository's root, or name a page with --write"
        )
    for page in pages:
        check_page(page, report)
    if not named:
        check_pictures(report.curves)
        check_films(report.collection, report.failures, FILMS)
    typer.echo(f"up to date with the stored results: {', '.join(map(str, pages))}")


def _print_tables(report: Report, names: Iterable[str]) -> None:
    screen = console()
    for name in names:
        table = report.tables[name]
        if table.rows:
            screen.print(table.rich())
            screen.print()


def _print(report: Report) -> None:
    _print_tables(report, report.tables)
    screen = console()
    screen.print(Text(order_in_words(report.collection).replace("`", "")))
    for line in report.missing:
        typer.echo(f"Missing: {line}", err=True)
    for line in report.differences:
        typer.echo(f"Note: {line}", err=True)


def _noted(stored: Path, before: set[Path], agent: str | None) -> str:
    """Return what a user should know who did not mean it: a file is replaced, or the agent's name is misspelt."""
    replaced = ", in place of the file that was there" if stored in before else ""
    known = [one.name for one in list_agents()]
    return replaced + (did_you_mean(agent, known) if agent not in known else "")
