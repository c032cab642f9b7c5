"""All figures of some runs, as files: what ``wrongturn results --figures`` draws."""

import re
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import typer
from matplotlib.figure import Figure

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.records import EvaluationRecord
from wrongturn_figures.junction_maps import beside_twins, installed_town, town_of, trajectories
from wrongturn_figures.look import COLUMN, PAGE, save
from wrongturn_figures.rate_charts import pairs, unsafe_rates
from wrongturn_figures.safety_plane import obedience_safety

_NOT_IN_FILE_NAMES: Final = re.compile(r"[^A-Za-z0-9._-]+")


def draw(runs: Sequence[EvaluationRecord], folder: Path, formats: Sequence[str], width: str, url: str | None) -> None:
    """Draw each figure of the runs into a folder, as ``wrongturn results --figures``.

    ``formats`` are endings such as ``pdf``, ``width`` is ``column`` or ``page``. The service at ``url``, if any, has
    the towns. Each file's name is printed on stderr.

    Raises:
        ResultsError: A file cannot be written, two agents' files have one name, or the suite has no twins.
    """
    for name, drawing in _drawings(runs, PAGE if width == "page" else COLUMN, url):
        figure = drawing()
        for kind in formats:
            typer.echo(str(save(figure, folder / f"{name}.{kind}")), err=True)


def _drawings(
    runs: Sequence[EvaluationRecord], width: float, url: str | None
) -> Iterator[tuple[str, Callable[[], Figure]]]:
    """Yield the name of each figure, and what draws it."""
    towns = installed_town if url is None else town_of(url)
    yield "unsafe-rates", partial(unsafe_rates, runs, width=width)
    yield "obedience-safety", partial(obedience_safety, runs, width=width)
    yield "pairs", partial(pairs, runs, width=width)
    names = [_NOT_IN_FILE_NAMES.sub("-", run.agent) for run in runs]
    for run, name in zip(runs, names, strict=True):
        if names.count(name) > 1:
            raise ResultsError(f"--figures: two agents' files would be called {name}; name one anew by NAME=RUN")
        if not any(drive.path for drive in run.trials):
            typer.echo(f"{run.agent}: the stored results have no trajectories to draw", err=True)
            continue
        yield f"trajectories-{name}", partial(trajectories, run, width=width, towns=towns)
        if any(drive.result.unsafe_strict and drive.path for drive in run.trials):
            yield f"twins-{name}", partial(beside_twins, run, width=width, towns=towns)
