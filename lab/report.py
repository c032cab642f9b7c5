"""All tables of the stored results, and the pages that show them between markers."""

import os
import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Self

from lab import navigation, order, study_tables, wrong_command
from lab.curve_pictures import PICTURES
from lab.curves import Curve, imitation_table, read_curves, time_table, training_table
from lab.evaluations import Evaluation, evaluations_table, read_evaluations
from lab.failures import Failures, failures_file
from lab.failures_page import collisions_text, counts_table, ways_text
from lab.paths import LAB
from lab.studies import Draws, Judgings, draws_file, judgings_file
from lab.tables import ReportTable, Rows, label_first, spread, with_interval
from wrongturn_agents.errors import OutdatedPageError, ResultsError
from wrongturn_agents.stored_results import Collection
from wrongturn_agents.suites import NAVIGATION, WRONG_COMMAND
from wrongturn_protocol import Condition, Task

_BEGIN: Final = "<!-- wrongturn results: "
_END: Final = "<!-- end of results -->"
_SECTION: Final = re.compile(
    rf"(?P<begin>{_BEGIN}(?P<name>[a-z-]+) -->\n)(?P<body>.*?)(?P<end>{_END})",
    re.DOTALL,
)
_ABLATED: Final = tuple(condition for condition in Condition if condition is not Condition.TRAINING)
_CURVES: Final = dict(zip(("curves", "imitation-curves"), PICTURES, strict=True))
_REMEDY: Final = f"write '{_BEGIN}NAME -->' and '{_END}' on lines of their own"


@dataclass(frozen=True)
class Report:
    """Tables, texts and figures of the stored results."""

    collection: Collection
    curves: tuple[Curve, ...]
    judgings: Judgings | None = None
    draws: Draws | None = None
    evaluations: tuple[Evaluation, ...] = ()
    failures: Failures | None = None

    @classmethod
    def read(cls, directory: Path, studies: Path = LAB) -> Self:
        """Read everything that a directory of results holds.

        Raises:
            ResultsError: As :meth:`Collection.read`; or a curve or study is not valid.
        """
        return cls(
            Collection.read(directory),
            read_curves(studies / "curves"),
            Judgings.read(judgings_file(studies)),
            Draws.read(draws_file(studies)),
            read_evaluations(studies),
            Failures.read(failures_file(studies)),
        )

    @cached_property
    def tables(self) -> dict[str, ReportTable]:
        """Tables by name of their section, in the order in which the terminal shows them."""
        return {
            "navigation": navigation.navigation_table(self.collection),
            "tasks": navigation.tasks_table(self.collection),
            "clean": navigation.tasks_table(self.collection, clean=True),
            "wrong-command": wrong_command.wrong_command_table(self.collection),
            "paper-column": wrong_command.wrong_command_table(self.collection, strict=False),
            "seeds": wrong_command.seeds_table(self.collection),
            "endings": wrong_command.endings_table(self.collection),
            "ablations": ablation_table(self.collection),
            "sensitivity": study_tables.sensitivity_table(self.judgings),
            "draws": study_tables.draws_table(self.draws),
            "evaluations": evaluations_table(self.evaluations),
            "failure-counts": counts_table(self.collection, self.failures),
            "training": training_table(self.curves),
            "imitation": imitation_table(self.curves),
            "time": time_table(self.curves),
        }

    @property
    def sections(self) -> tuple[str, ...]:
        """Names of all sections that a page may have."""
        return (*self.tables, "summary", "order", *_CURVES, "missing", "failures", "collisions")

    @property
    def missing(self) -> tuple[str, ...]:
        """Lines that say what the tables lack."""
        return tuple(self.collection.missing((NAVIGATION, WRONG_COMMAND)))

    @property
    def differences(self) -> tuple[str, ...]:
        """Lines that say where results in process differ from those over the service."""
        return tuple(self.collection.differences())

    def section(self, name: str, page: Path) -> str:
        """Return the Markdown of a section, for a page at this path below the repository's root."""
        if name == "summary":
            return wrong_command.summary_table(self.collection).markdown()
        if name == "order":
            return order.order_in_words(self.collection)
        if name == "missing":
            return "".join(f"- {line}\n" for line in self.missing + self.differences) or "Nothing is missing.\n"
        if name in _CURVES:
            picture = _CURVES[name]
            if not picture.curves_of(self.curves):
                return "*No learning curve is stored yet.*\n"
            return f"![{picture.seen}]({os.path.relpath(picture.path, page.parent)})\n"
        if name == "failures":
            return ways_text(self.collection, self.failures, page)
        if name == "collisions":
            return collisions_text(self.failures, page)
        return self.tables[name].markdown()

    def as_json(self) -> dict[str, Any]:
        """Return all figures for a program."""
        return {
            "navigation": navigation.as_json(self.collection),
            "wrong_command": wrong_command.as_json(self.collection),
            "order": order.as_json(self.collection),
            "ablations": [
                {
                    "agent": agent,
                    "variant": variant,
                    "unsafe_strict_by_seed": {
                        str(seed): one.unsafe_strict
                        for seed, one in wrong_command.counts_by_seed(self.collection, agent, variant).items()
                    },
                    "navigation_by_seed": {
                        str(seed): {f"{task}.{condition}": one.arrived for (task, condition), one in cells.items()}
                        for seed, cells in navigation.success_by_seed(self.collection, agent, variant).items()
                    },
                }
                for agent, variant in self.collection.variants
            ],
            "missing": [*self.missing, *self.differences],
        }


def ablation_table(collection: Collection) -> ReportTable:
    """Return what each part of a training is worth: variants without it, below the standard algorithm."""
    variants: dict[str, list[str | None]] = {}
    for agent, variant in collection.variants:
        variants.setdefault(agent, [None]).append(variant)
    rows: Rows = []
    for agent, named in variants.items():
        own = (((one or "standard").replace("-", " "), *_ablation_figures(collection, agent, one)) for one in named)
        rows += label_first(f"`{agent}`", own)
    conditions = (navigation.CONDITIONS[condition] for condition in _ABLATED)
    head = ("agent", "variant", "seeds", *conditions, "unsafe of 60, strict", "twins")
    note = (
        "Navigation in % of 25 routes; unsafe trials (strict) and completed twins of 60, on the open draw. One seed: "
        "with Wilson's 95 % interval. Several seeds: the median [lowest–highest]."
    )
    return ReportTable("Ablations", head, tuple(rows), note)


def _ablation_figures(collection: Collection, agent: str, variant: str | None) -> tuple[str, ...]:
    journeys = navigation.success_by_seed(collection, agent, variant)
    counts = wrong_command.counts_by_seed(collection, agent, variant)
    seeds = ", ".join(sorted(str(seed) for seed in journeys.keys() | counts.keys()))
    cells = ([each.get((Task.NAVIGATION, condition)) for each in journeys.values()] for condition in _ABLATED)
    success = (_over_seeds([(one.arrived, one.episodes) for one in cell if one], percent=True) for cell in cells)
    unsafe = _over_seeds([(one.unsafe_strict, one.trials) for one in counts.values()])
    return (seeds, *success, unsafe, _over_seeds([(one.completed, one.twins) for one in counts.values()]))


def _over_seeds(found: list[tuple[int, int]], *, percent: bool = False) -> str:
    """Return counts, each with its total, as text: one seed with its interval, several with their spread."""
    if not found:
        return "–"
    if len(found) == 1:
        return with_interval(*found[0], percent=percent)
    return spread([100 * count / of if percent else count for count, of in found])


def find_pages(root: Path) -> list[Path]:
    """Return the repository's pages that have sections: in its root, and anywhere in ``docs``."""
    pages = sorted([*root.glob("*.md"), *root.glob("docs/**/*.md")])
    return [page for page in pages if _BEGIN in page.read_text(encoding="utf-8")]


def write_page(page: Path, report: Report) -> bool:
    """Write a page's sections, and return whether anything changed.

    Raises:
        ResultsError: The page cannot be read or written; or it has no section, an unknown one, or one without an end.
    """
    old = _read(page)
    new = _filled(page, old, report)
    if new == old:
        return False
    try:
        page.write_text(new, encoding="utf-8")
    except OSError as error:
        raise ResultsError(
            f"{page}: cannot be written ({error.strerror}); name another, or make it writable"
        ) from error
    return True


def check_page(page: Path, report: Report) -> None:
    """Check that a page shows the stored results.

    Raises:
        OutdatedPageError: It does not. The error names the sections.
        ResultsError: As :func:`write_page`.
    """
    old = _read(page)
    pairs = zip(_SECTION.finditer(old), _SECTION.finditer(_filled(page, old, report)), strict=True)
    wrong = [before["name"] for before, after in pairs if before["body"] != after["body"]]
    if wrong:
        raise OutdatedPageError(
            f"{page}: {', '.join(wrong)}: does not show the stored results; "
            f"write it with 'python -m lab.results --write {page}'",
        )


def _read(page: Path) -> str:
    try:
        return page.read_text(encoding="utf-8")
    except OSError as error:
        raise ResultsError(f"{page}: cannot be read ({error.strerror}); name a page that exists") from error
    except UnicodeDecodeError as error:
        raise ResultsError(f"{page}: is not text in UTF-8; name a page") from error


def _filled(page: Path, text: str, report: Report) -> str:
    """Return a page's text with new sections."""
    begun, found = text.count(_BEGIN), list(_SECTION.finditer(text))
    if not begun:
        raise ResultsError(f"{page}: has no section for results; {_REMEDY}")
    if begun != len(found) or text.count(_END) != begun:
        raise ResultsError(f"{page}: {begun} sections for results begin, {len(found)} are whole; {_REMEDY}")
    unknown = [match["name"] for match in found if match["name"] not in report.sections]
    if unknown:
        known = ", ".join(report.sections)
        raise ResultsError(f"{page}: there is no section {unknown[0]!r}; known are {known}")
    return _SECTION.sub(lambda match: f"{match['begin']}\n{report.section(match['name'], page)}\n{match['end']}", text)
