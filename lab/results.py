"""Makes the tables, pictures and studies of this repository's own pages: ``python -m lab.results --help``."""

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

from lab.curve_pictures import check_pictures, draw_pictures
from lab.failures import FILMS, check_films
from lab.importing import Overrides, import_results
from lab.making_evaluations import make_evaluations
from lab.making_failures import make_failures
from lab.making_studies import make_draws, make_judgings
from lab.order import order_in_words
from lab.paths import LAB
from lab.report import Report, check_page, find_pages, write_page
from wrongturn_agents.errors import AgentsError, ResultsError
from wrongturn_agents.stored_results import STORED
from wrongturn_client.tables import console
from wrongturn_protocol.json_output import STDOUT, JsonTo, check_json_file, give_json, with_stdout


def results(
    *,
    directory: Annotated[Path, typer.Option(help="Directory of the results.")] = STORED,
    json_to: JsonTo = None,
    write: Annotated[
        list[Path] | None,
        typer.Option(metavar="PAGE", help="Write the tables into a page. Example: --write docs/results.md"),
    ] = None,
    check: Annotated[
        bool, typer.Option("--check", help="Fail if a page or a picture differs from what is stored. Writes nothing.")
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
        bool, typer.Option("--sensitivity", help="Drive on past the verdicts, and judge by other thresholds.")
    ] = False,
    failures: Annotated[
        bool, typer.Option("--failures", help="Drive the unsafe trials again, measure them, and make the films.")
    ] = False,
    draws: Annotated[int | None, typer.Option(metavar="N", help="Drive the agents through N draws.", min=2)] = None,
    evaluations: Annotated[
        int | None, typer.Option(metavar="N", help="Drive N evaluations of each --agent over services.", min=1)
    ] = None,
    agent: Annotated[
        list[str] | None, typer.Option(help="Agent of the import, or agents to drive. Give it again for another.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Training seed of the import.", min=0)] = None,
    variant: Annotated[str | None, typer.Option(help="Ablation of the import.")] = None,
    steps: Annotated[int | None, typer.Option(help="Training steps of the import.", min=0)] = None,
) -> None:
    """Make the tables, pictures and studies of this repository's pages. Interrupted studies go on where they stopped.

    Example: python -m lab.results --check
    """
    check_json_file(json_to)
    studied = sensitivity or failures or draws is not None or evaluations is not None
    agents = agent or []
    for source in sources or ():
        overrides = Overrides(agents[0] if agents else None, seed, variant, steps)
        typer.echo(f"{source}: stored as {import_results(source, directory, overrides).name}", err=True)
    if sensitivity:
        typer.echo(f"stored as {make_judgings(LAB, agents)}", err=True)
    if draws is not None:
        typer.echo(f"stored as {make_draws(LAB, agents, draws)}", err=True)
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


def main() -> None:
    """Run the program; an error is one line."""
    sys.argv[1:] = with_stdout(sys.argv[1:])
    try:
        typer.run(results)
    except (AgentsError, OSError) as error:
        raise SystemExit(f"lab.results: {error}") from error


if __name__ == "__main__":
    main()
