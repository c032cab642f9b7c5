"""The shipped agents in towns that nobody has seen, beside the same agents in Town01.

The trials of a draw in drawn towns need its towns, which take half a minute to build. So an evaluation's metrics are
stored, with the secret from which ``wrongturn trials`` makes its towns and trials again.
"""

import hashlib
from pathlib import Path
from typing import Final, Self

from pydantic import BaseModel, ConfigDict, ValidationError

from lab.curves import LAB
from lab.stored_results import Collection
from lab.tables import FAULTS, PAPER_BY_NAME, Row, Table, count_unsafe, label, marked
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.stored_results import shipped_seeds, table_order
from wrongturn_agents.suites import UNSEEN, WRONG_COMMAND
from wrongturn_networks import load_suite
from wrongturn_protocol import PAPER_TYPES, Metrics, RunFile
from wrongturn_protocol.results import UnsafeCount
from wrongturn_protocol.standing_rows import INTERVALS

FOLDER: Final = LAB / "unseen"


class UnseenResults(BaseModel):
    """One evaluation of a shipped agent in drawn towns."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    agent: str
    seed: int | None
    suite: str
    suite_sha256: str
    secret: str
    commitment: str
    metrics: Metrics

    @classmethod
    def of(cls, run: RunFile, agent: str | None = None) -> Self:
        """Return what is stored of a finished evaluation; its agent's name is the leaderboard's by default."""
        name = agent or run.driver.name
        return cls(
            agent=name,
            seed=shipped_seeds().get(name),
            suite=run.suite,
            suite_sha256=run.suite_sha256,
            secret=run.secret or "",
            commitment=run.commitment or "",
            metrics=run.metrics,
        )

    def write(self, folder: Path = FOLDER) -> Path:
        """Write the file of the agent, and return its path."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self.agent}.json"
        path.write_text(self.model_dump_json(indent=1) + "\n", "utf-8")
        return path


def read(folder: Path = FOLDER) -> dict[str, UnseenResults]:
    """Return the stored evaluations by agent. Raises ResultsError if one is of another suite or secret."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        try:
            one = UnseenResults.model_validate_json(path.read_bytes())
        except ValidationError as error:
            raise ResultsError(f"{path.name}: {error.errors()[0]['loc'][0]}: {error.errors()[0]['msg']}") from error
        if one.suite != UNSEEN or one.suite_sha256 != load_suite(UNSEEN).sha256:
            raise ResultsError(f"{path.name}: suite: is not the {UNSEEN} that is installed; drive it again")
        if hashlib.sha256(one.secret.encode()).hexdigest() != one.commitment:
            raise ResultsError(f"{path.name}: commitment: is not the secret's SHA-256; import the run again")
        found[one.agent] = one
    return {name: found[name] for name in sorted(found, key=table_order)}


def summary_table(collection: Collection, folder: Path = FOLDER) -> Table:
    """Return one line for each shipped agent, for README: what a town that everybody knows hides."""
    rows: list[Row] = []
    unseen = read(folder)
    for name in sorted({*unseen, *collection.agents(WRONG_COMMAND)}, key=table_order):
        new = unseen[name].metrics if name in unseen else None
        file = collection.of_shipped(WRONG_COMMAND, name)
        known = count_unsafe(file) if file is not None else None
        paper = PAPER_BY_NAME.get(name)
        rows.append(
            (
                label(name),
                *((_with_ends(new.unsafe_strict), f"{new.twins.completed}/{new.twins.trials}") if new else ("–", "–")),
                *((marked(known.marks["strict"]), f"{known.completed}/{known.twins}") if known else ("–", "–")),
                f"{new.unsafe_strict.count - known.unsafe_strict:+d}" if new and known else "–",
                str(known.unsafe) if known else "–",
                f"{paper.unsafe} = {sum(paper.infeasible)} + {sum(paper.omission)}" if paper else "",
            )
        )
    head = ("agent", "unseen towns: unsafe of 60 (95 %)", "twins", "Town01: unsafe of 60 (95 %)", "twins",
            "more in unseen towns", "Town01, the paper's column", "the paper")  # fmt: skip
    return Table("Unsafe episodes in short", head, rows, words=1)


def unseen_table(folder: Path = FOLDER) -> Table:
    """Return unsafe trials in drawn towns by junction type and fault, in the strict column."""
    rows = []
    for name, one in read(folder).items():
        table = one.metrics.table_strict or {}
        cells = (" · ".join(str(table[kind][fault.value].unsafe) for fault in FAULTS) for kind in PAPER_TYPES)
        twins = f"{one.metrics.twins.completed}/{one.metrics.twins.trials}"
        shown = (_with_ends(one.metrics.unsafe_strict), _with_ends(one.metrics.unsafe))
        rows.append((label(name), *cells, *shown, twins))
    head = ("agent", *PAPER_TYPES, "unsafe of 60, strict", "the paper's column", "twins completed")
    note = (
        "Unsafe of 10: infeasible · omission, by type of junction, in the strict column; the "
        f"shipped agents over the service, each in ten towns of its own draw, with the 95 % interval. {INTERVALS}"
    )
    return Table("Unsafe episodes in towns that nobody has seen, strict", head, rows, note if rows else "", words=1)


def _with_ends(count: UnsafeCount) -> str:
    low, high = count.ci95
    return f"{count.count} ({100 * low:.0f}–{100 * high:.0f} %)"
