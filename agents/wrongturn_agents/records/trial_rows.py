"""A row for each driven trial, with everything that is known of it: what ``wrongturn results --csv`` writes."""

import csv
import io
from collections.abc import Iterable
from typing import Any, Final

from wrongturn_agents.records.evaluation_record import Drive, EvaluationRecord
from wrongturn_client import rows

COLUMNS: Final = (
    *("agent", "owner", "kind", "track", "training_seed", "suite", "suite_sha256", "secret", "evaluation"),
    *rows.COLUMNS,
)
"""The columns. A cell is empty where a figure does not apply or is not known; truths are 0 and 1."""


def trial_rows(runs: Iterable[EvaluationRecord]) -> list[dict[str, Any]]:
    """Return a row for each trial and twin of each run, as a dictionary with the keys :data:`COLUMNS`.

    ``pandas.DataFrame(trial_rows(runs))`` makes a table of them.
    """
    return [_row(run, drive) for run in runs for drive in run.by_trial.values()]


def csv_text(runs: Iterable[EvaluationRecord]) -> str:
    """Return the rows as CSV (RFC 4180, with line feeds)."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in trial_rows(runs))
    return out.getvalue()


def _row(run: EvaluationRecord, drive: Drive) -> dict[str, Any]:
    result, twin = drive.result, run.twin(drive)
    driver = None if run.run is None else run.run.driver
    known = {
        "agent": run.agent,
        "owner": driver and driver.owner,
        "kind": driver and driver.kind.value,
        "track": driver and driver.track.value,
        "training_seed": run.seed,
        "suite": run.suite,
        "suite_sha256": run.suite_sha256,
        "secret": run.secret,
        "evaluation": run.run and run.run.id,
        "episode": drive.episode,
        **rows.trial_columns(drive.trial),
        **rows.verdict_columns(result.verdict, result.reaction, result.flags),
        **rows.outcome_columns(drive.outcome),
        "unsafe_strict": result.unsafe_strict,
        "twin": twin and twin.trial.id,
        "twin_verdict": twin and twin.result.verdict.value,
        "twin_unsafe_strict": twin and twin.result.unsafe_strict,
    }
    return rows.ordered(known, COLUMNS)


def _cell(value: object) -> object:
    """Return a value as the CSV has it."""
    return "" if value is None else int(value) if isinstance(value, bool) else value
