"""``wrongturn results``: the paper's table, figures, LaTeX and CSV of your runs."""

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from wrongturn_agents import figures, merging
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.figures.evaluation_record import EvaluationRecord, checked
from wrongturn_agents.results_file import text_of
from wrongturn_agents.stored_results import shipped_results
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_client.tables import breakdown_table, console
from wrongturn_protocol.json_output import STDOUT, check_json_file, write_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_NOT_IN_FILE_NAMES: Final = re.compile(r"[^A-Za-z0-9._-]+")


class Width(StrEnum):
    """Width of a figure in a paper of two columns."""

    COLUMN = "column"
    PAGE = "page"

    @property
    def inches(self) -> float:
        """The width in inches."""
        return figures.COLUMN if self is Width.COLUMN else figures.PAGE


class Format(StrEnum):
    """Format of a figure's file."""

    PDF = "pdf"
    SVG = "svg"
    PNG = "png"


def results(
    runs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[RUN]...",
            help="Files of 'wrongturn run --json' or 'wrongturn score --json', or names of agents with results, stored "
            "or on a service (--url). NAME=RUN shows it under another name. By default all shipped agents. "
            "Example: run.json.gz",
        ),
    ] = None,
    *,
    folder: Annotated[
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
    paper: Annotated[bool, typer.Option("--paper", help="Put the paper's agents first in the table.")] = False,
    url: Annotated[
        str | None,
        typer.Option(metavar="URL", help="Service with the agents and towns. Example: --url http://127.0.0.1:8000"),
    ] = None,
    suite: Annotated[
        str, typer.Option(help="Suite of the agents that you name without a file. Example: --suite smoke@3")
    ] = WRONG_COMMAND,
    merge: Annotated[
        bool, typer.Option("--merge", help="Merge the files of 'wrongturn run --shard' into the one file of --json.")
    ] = False,
    json_file: Annotated[
        Path | None,
        typer.Option(
            "--json", metavar="[FILE]", help="Write the merged results there; see --merge. Example: --json all.json"
        ),
    ] = None,
) -> None:
    """Show finished runs as the paper's table, or make figures, LaTeX and CSV of them.

    Example: wrongturn results run.json.gz careful

    For a paper: wrongturn results --figures figures --latex table.tex --csv trials.csv run.json.gz

    Pieces of a run: wrongturn results --merge piece-1.json piece-2.json --json all.json
    """
    if merge or json_file is not None:
        if not merge or json_file is None:
            raise ResultsError(
                "--merge: writes the file of --json; give both. Example: --merge 1.json 2.json --json all.json"
            )
        check_json_file(json_file)
        _write(json_file, text_of(merging.merge([Path(run) for run in runs or ()])))
        return
    files = [find_records(one, url, suite) for one in runs or _shipped(suite)]
    found = checked([run for file in files for run in figures.pooled(file)])
    if csv is not None:
        _write(csv, figures.csv_text(run for file in files for run in file))
    if latex is not None:
        _write(latex, figures.latex_table(found, paper=paper))
    if folder is not None:
        _draw(found, folder, formats or [Format.PDF, Format.PNG], width.inches, url)
    if (csv, latex, folder) == (None, None, None):
        console().print(figures.results_table(found, paper=paper))
        for run in (run for file in files for run in file):
            if run.run is not None and (table := breakdown_table(run.label, run.run.metrics)) is not None:
                console().print(table)


def _draw(
    runs: Sequence[EvaluationRecord], folder: Path, formats: Sequence[Format], width: float, url: str | None
) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultsError(f"--figures: {folder} cannot be made ({error.strerror}); name another folder") from error
    for name, draw in _drawings(runs, width, url):
        figure = draw()
        for kind in formats:
            typer.echo(str(figures.save(figure, folder / f"{name}.{kind}")), err=True)


def _drawings(
    runs: Sequence[EvaluationRecord], width: float, url: str | None
) -> Iterator[tuple[str, "Callable[[], Figure]"]]:
    """Yield the name of each figure, and what draws it."""
    towns = figures.installed_town if url is None else figures.town_of(url)
    yield "unsafe-rates", partial(figures.unsafe_rates, runs, width=width)
    yield "obedience-safety", partial(figures.obedience_safety, runs, width=width)
    yield "pairs", partial(figures.pairs, runs, width=width)
    for run in runs:
        name = _NOT_IN_FILE_NAMES.sub("-", run.agent)
        if sum(_NOT_IN_FILE_NAMES.sub("-", other.agent) == name for other in runs) > 1:
            raise ResultsError(f"--figures: two agents' files would be called {name}; name one anew by NAME=RUN")
        if not any(drive.path for drive in run.trials):
            typer.echo(f"{run.agent}: the stored results have no trajectories to draw", err=True)
            continue
        yield f"trajectories-{name}", partial(figures.trajectories, run, width=width, towns=towns)
        if any(drive.result.unsafe_strict and drive.path for drive in run.trials):
            yield f"twins-{name}", partial(figures.beside_twins, run, width=width, towns=towns)


def find_records(text: str, url: str | None, suite: str) -> list[EvaluationRecord]:
    """Return a file's runs, or one of the service or the stored results, under the name that the user gives it."""
    name, equals, rest = text.partition("=")
    if Path(text).exists() or not equals:
        name, rest = "", text
    if Path(rest).is_file():
        found = figures.read_runs_of(rest)
    elif Path(rest).suffix in {".json", ".gz"}:
        raise ResultsError(f"RUN: {rest} is no file; give one that 'wrongturn run --json' wrote")
    elif url is not None:
        found = [figures.fetch(url, rest, suite)]
    else:
        found = [figures.stored(rest, suite)]
    if name.strip() and len(figures.pooled(found)) > 1:
        raise ResultsError(f"RUN: {rest} has runs of several agents, which keep their names; leave {name}= out")
    return [run.named(name.strip()) for run in found] if name.strip() else found


def _shipped(suite: str) -> list[str]:
    """Return the names of the shipped agents with stored results."""
    found = [*shipped_results(suite)]
    if not found:
        raise ResultsError(f"RUN: nothing is stored on {suite}; give files of 'wrongturn run --json'")
    return found


def _write(path: Path, text: str) -> None:
    """Write text into a file, or to stdout for ``-``."""
    if path == STDOUT:
        sys.stdout.write(text)
        return
    try:
        write_whole([text.encode()], path)
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written ({error.strerror}); name another file") from error
    typer.echo(str(path), err=True)
