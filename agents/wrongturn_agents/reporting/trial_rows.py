"""A row for each driven trial, with everything that is known of it: what ``wrongturn results --csv`` writes."""

import csv
import io
from collections.abc import Iterable
from typing import Any, Final

from wrongturn_agents.reporting.drives import Drive, Drives
from wrongturn_protocol import Condition

_OUTCOME: Final = (
    "time",
    "min_ttc",
    "max_deceleration",
    "kerb_bite_m",
    "kerb_bite_s",
    "opposed_lane_m",
    "over_line_m",
    "first_stop_s",
)
_JOURNEY: Final = ("distance", "completion", "junctions", "off_road", "wrong_lane", "collisions")
COLUMNS: Final = (
    *("agent", "owner", "kind", "track", "training_seed", "suite", "suite_sha256", "secret", "evaluation", "episode"),
    *("trial", "twin", "town", "approach", "junction_type", "route", "fault", "weather", "vehicles", "pedestrians"),
    *("start_distance", "start_speed", "start_lateral", "start_yaw", "window", "seed", "task", "condition"),
    *("verdict", "reaction", "flags", "exit", "unsafe", "unsafe_strict", "twin_verdict", "twin_unsafe_strict"),
    *_OUTCOME,
    *(f"journey_{name}" for name in _JOURNEY),
)
"""The columns. A cell is empty where a figure does not apply or is not known; truths are 0 and 1."""


def trial_rows(runs: Iterable[Drives]) -> list[dict[str, Any]]:
    """Return a row for each trial and twin of each run, as a dictionary with the keys :data:`COLUMNS`.

    ``pandas.DataFrame(trial_rows(runs))`` makes a table of them.
    """
    return [_row(run, drive) for run in runs for drive in run.by_trial.values()]


def csv_text(runs: Iterable[Drives]) -> str:
    """Return the rows as CSV (RFC 4180, with line feeds)."""
    out = io.StringIO()
    writer = csv.DictWriter(out, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in trial_rows(runs))
    return out.getvalue()


def _row(run: Drives, drive: Drive) -> dict[str, Any]:
    trial, result, twin = drive.trial, drive.result, run.twin(drive)
    driver = None if run.run is None else run.run.driver
    journey = None if drive.outcome is None else drive.outcome.journey
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
        "trial": trial.id,
        "twin": twin and twin.trial.id,
        "town": trial.town,
        "approach": trial.approach,
        "junction_type": trial.junction_type.value,
        "route": trial.route.name,
        "fault": trial.fault.kind.value,
        "weather": trial.weather.value,
        "vehicles": trial.traffic.vehicles,
        "pedestrians": trial.traffic.pedestrians,
        **{f"start_{name}": value for name, value in trial.start.model_dump().items()},
        "window": trial.window,
        "seed": trial.seed,
        "task": trial.journey and trial.journey.task.value,
        "condition": trial.journey and Condition.of(trial.town, trial.weather).value,
        "verdict": result.verdict.value,
        "reaction": result.reaction and result.reaction.value,
        "flags": ";".join(result.flags),
        "exit": drive.outcome.exit.name if drive.outcome and drive.outcome.exit else None,
        "unsafe": result.unsafe,
        "unsafe_strict": result.unsafe_strict,
        "twin_verdict": twin and twin.result.verdict.value,
        "twin_unsafe_strict": twin and twin.result.unsafe_strict,
        **{name: getattr(drive.outcome, name, None) for name in _OUTCOME},
        **{f"journey_{name}": getattr(journey, name, None) for name in _JOURNEY},
    }
    return {name: known[name] for name in COLUMNS}


def _cell(value: object) -> object:
    """Return a value as the CSV has it."""
    return "" if value is None else int(value) if isinstance(value, bool) else value
