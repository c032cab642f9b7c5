"""Figures, LaTeX tables and CSV for ``wrongturn results``."""

import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import typer

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.reporting import figures
from wrongturn_agents.reporting.collection import Collection
from wrongturn_agents.reporting.drives import Drives, checked

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_STDOUT: Final = Path("-")
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


@dataclass(frozen=True)
class Wanted:
    """What to make of which runs."""

    runs: Sequence[str]
    """Run files, names of agents, or ids of evaluations, each perhaps as ``NAME=RUN``; empty for all shipped agents."""
    directory: Path
    """Directory of the stored results."""
    url: str | None
    """The service with the agents that are named without a file; None for the stored results."""
    suite: str
    """Suite of the agents that you name without a file."""
    folder: Path | None
    """Folder of the figures."""
    latex: Path | None
    csv: Path | None
    width: Width
    formats: Sequence[Format]
    paper: bool
    """Put the paper's agents into the LaTeX table."""


def make(wanted: Wanted) -> None:
    """Make everything that is wanted, and say what was written.

    Raises:
        ResultsError: A run cannot be had, or does not fit what is wanted.
        MissingPackageError: matplotlib or scipy is not installed.
        WrongturnError: The service cannot be reached.
    """
    named = wanted.runs or _shipped(wanted.directory, wanted.suite)
    runs = checked([_find(one, wanted) for one in named])
    if wanted.csv is not None:
        _write(wanted.csv, figures.csv_text(runs))
    if wanted.latex is not None:
        _write(wanted.latex, figures.latex_table(runs, paper=wanted.paper))
    if wanted.folder is not None:
        _draw(runs, wanted, wanted.folder)


def _draw(runs: Sequence[Drives], wanted: Wanted, folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ResultsError(f"--figures: {folder} cannot be made ({error.strerror}); name another folder") from error
    for name, draw in _drawings(runs, wanted):
        figure = draw()
        for kind in wanted.formats:
            typer.echo(str(figures.save(figure, folder / f"{name}.{kind}")), err=True)


def _drawings(runs: Sequence[Drives], wanted: Wanted) -> Iterator[tuple[str, "Callable[[], Figure]"]]:
    """Yield the name of each figure, and what draws it."""
    width = wanted.width.inches
    towns = figures.installed_town if wanted.url is None else figures.town_of(wanted.url)
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


def _find(text: str, wanted: Wanted) -> Drives:
    """Return a run from a file, the service, or the stored results, under the name that the user gives it."""
    name, equals, rest = text.partition("=")
    if Path(text).exists() or not equals:
        name, rest = "", text
    if Path(rest).is_file():
        run = figures.read(rest)
    elif Path(rest).suffix in {".json", ".gz"}:
        raise ResultsError(f"RUN: {rest} is no file; give one that 'wrongturn run --json' wrote")
    elif wanted.url is not None:
        run = figures.fetch(wanted.url, rest, wanted.suite)
    else:
        run = figures.stored(rest, wanted.suite, wanted.directory)
    return run.named(name.strip()) if name.strip() else run


def _shipped(directory: Path, suite: str) -> list[str]:
    """Return the names of the shipped agents with stored results."""
    collection = Collection.read(directory)
    found = [name for name in collection.agents(suite) if collection.of_shipped(suite, name) is not None]
    if not found:
        raise ResultsError(f"RUN: nothing is stored on {suite}; give files of 'wrongturn run --json'")
    return found


def _write(path: Path, text: str) -> None:
    """Write text into a file, or to stdout for ``-``."""
    if path == _STDOUT:
        sys.stdout.write(text)
        return
    try:
        path.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise ResultsError(f"{path}: cannot be written ({error.strerror}); name another file") from error
    typer.echo(str(path), err=True)
