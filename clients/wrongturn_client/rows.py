"""A row for each driven trial: the columns of ``Evaluation.to_frame`` and of ``wrongturn results --csv``."""

from collections.abc import Iterable, Mapping
from typing import Any, Final

from wrongturn_protocol import Condition, EpisodeDetail, Flag, Outcome, Reaction, Trial, Verdict
from wrongturn_protocol.episodes import twin_id

_FIGURES: Final = (
    "time",
    "speed_at_verdict",
    "min_ttc",
    "min_ttc_users",
    "min_ttc_solids",
    "max_deceleration",
    "kerb_bite_m",
    "kerb_bite_s",
    "opposed_lane_m",
    "over_line_m",
    "stop_past_line_m",
    "first_stop_s",
)
_JOURNEY: Final = ("distance", "completion", "junctions", "off_road", "wrong_lane", "collisions")
COLUMNS: Final = (
    *("episode", "trial", "twin", "town", "approach", "junction_type", "route", "fault", "dose", "weather"),
    *(
        "vehicles",
        "pedestrians",
        "start_distance",
        "start_speed",
        "start_lateral",
        "start_yaw",
        "window",
        "watch",
        "seed",
    ),
    *("task", "condition", "verdict", "reaction", "flags", "exit", "unsafe", "unsafe_strict"),
    *("twin_verdict", "twin_unsafe_strict"),
    *_FIGURES,
    *(f"journey_{name}" for name in _JOURNEY),
)
"""The columns, which ``docs/figures.md`` explains. A value is None where a figure does not apply or is not known."""


def episode_rows(episodes: Iterable[EpisodeDetail]) -> list[dict[str, Any]]:
    """Return a row with the keys :data:`COLUMNS` for each finished episode, in their order."""
    driven = {
        episode.trial_detail.id: (episode, episode.trial_detail, episode.outcome)
        for episode in episodes
        if episode.trial_detail is not None and episode.outcome is not None
    }
    rows = []
    for episode, trial, outcome in driven.values():
        twin = None if trial.is_twin else driven.get(twin_id(trial))
        row = {
            "episode": episode.id,
            **trial_columns(trial),
            **verdict_columns(outcome.verdict, outcome.reaction, outcome.flags),
            **outcome_columns(outcome),
            "unsafe_strict": outcome.unsafe_strict,
            "twin": twin and twin[1].id,
            "twin_verdict": twin and twin[2].verdict.value,
            "twin_unsafe_strict": twin and twin[2].unsafe_strict,
        }
        rows.append(ordered(row, COLUMNS))
    return rows


def trial_columns(trial: Trial) -> dict[str, Any]:
    """Return what was driven."""
    return {
        "trial": trial.id,
        "town": trial.town,
        "approach": trial.approach,
        "junction_type": trial.junction_type.value,
        "route": trial.route.name,
        "fault": trial.fault.kind.value,
        "dose": trial.fault.dose,
        "weather": trial.weather.value,
        "vehicles": trial.traffic.vehicles,
        "pedestrians": trial.traffic.pedestrians,
        **{f"start_{name}": value for name, value in trial.start.model_dump().items()},
        "window": trial.window,
        "watch": trial.watch,
        "seed": trial.seed,
        "task": trial.journey and trial.journey.task.value,
        "condition": trial.journey and Condition.of(trial.town, trial.weather).value,
    }


def verdict_columns(verdict: Verdict, reaction: Reaction | None, flags: Iterable[Flag]) -> dict[str, Any]:
    """Return how it ended."""
    return {
        "verdict": verdict.value,
        "reaction": reaction and reaction.value,
        "flags": ";".join(flags),
        "unsafe": verdict.unsafe,
    }


def outcome_columns(outcome: Outcome | None) -> dict[str, Any]:
    """Return the figures of an outcome; all are None without one."""
    journey = None if outcome is None else outcome.journey
    return {
        "exit": outcome.exit.name if outcome and outcome.exit else None,
        **{name: getattr(outcome, name, None) for name in _FIGURES},
        **{f"journey_{name}": getattr(journey, name, None) for name in _JOURNEY},
    }


def ordered(row: Mapping[str, Any], columns: Iterable[str]) -> dict[str, Any]:
    """Return a row's values in the order of these columns."""
    return {name: row[name] for name in columns}
