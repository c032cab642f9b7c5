"""``wrongturn results``: the paper's table, figures, LaTeX and CSV of your runs."""

import sys
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Final, Literal

import typer

from wrongturn_agents import merging, records
from wrongturn_agents.errors import MissingPackageError, ResultsError
from wrongturn_agents.records.evaluation_record import EvaluationRecord, checked
from wrongturn_agents.results_file import text_of
from wrongturn_agents.stored_results import shipped_results
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_client.plugins import entry_points, load
from wrongturn_client.tables import breakdown_table, console
from wrongturn_protocol.installing import install
from wrongturn_protocol.json_output import STDOUT, check_json_file, write_whole

DRAWINGS: Final = "wrongturn.drawings"


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
        Literal["column", "page"],
        typer.Option(help="Width of the figures: one column of a paper, or the page. Example: --width page"),
    ] = "column",
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
    found = checked([run for file in files for run in records.pooled(file)])
    if csv is not None:
        _write(csv, records.csv_text(run for file in files for run in file))
    if latex is not None:
        _write(latex, records.latex_table(found, paper=paper))
    if folder is not None:
        _draw(found, folder, formats or [Format.PDF, Format.PNG], width, url)
    if (csv, latex, folder) == (None, None, None):
        console().print(records.results_table(found, paper=paper))
        for run in (run for file in files for run in file):
            if run.run is not None and (table := breakdown_table(run.label, run.run.metrics)) is not None:
                console().print(table)


def _draw(runs: Sequence[EvaluationRecord], folder: Path, formats: Sequence[str], width: str, url: str | None) -> None:
    """Let each package that draws runs, as wrongturn-figures, draw them into a folder."""
    points = entry_points(DRAWINGS)
    if not points:
        raise MissingPackageError(f"--figures: nothing that draws is installed; {install('wrongturn-figures')}")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultsError(f"--figures: {folder} cannot be made ({error.strerror}); name another folder") from error
    for point in points.values():
        load(point)(runs, folder, formats, width, url)


def find_records(text: str, url: str | None, suite: str) -> list[EvaluationRecord]:
    """Return a file's runs, or one of the service or the stored results, under the name that the user gives it."""
    name, equals, rest = text.partition("=")
    if Path(text).exists() or not equals:
        name, rest = "", text
    if Path(rest).is_file():
        found = records.read_runs_of(rest)
    elif Path(rest).suffix in {".json", ".gz"}:
        raise ResultsError(f"RUN: {rest} is no file; give one that 'wrongturn run --json' wrote")
    elif url is not None:
        found = [records.fetch(url, rest, suite)]
    else:
        found = [records.stored(rest, suite)]
    if name.strip() and len(records.pooled(found)) > 1:
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
