"""Run files with trajectories that a test can check by hand."""

import math
from collections.abc import Callable
from typing import Any

from made_results import made_run

from wrongturn_networks import load_suite, load_town
from wrongturn_protocol import DrivenEpisode, FaultKind, Outcome, Reaction, RunFile, Trial, Verdict

Ending = Callable[[Trial], dict[str, Any]]
"""Returns the fields of a trial's outcome, the verdict among them."""
OFF_ROAD = {"verdict": Verdict.OFF_ROAD, "reaction": Reaction.OBEYED, "time": 4.0}


def leaves_the_road(trial: Trial) -> dict[str, Any]:
    return OFF_ROAD if trial.fault.kind is FaultKind.INFEASIBLE else {}


def straight_on(trial: Trial, metres: float) -> list[tuple[float, float]]:
    """Return positions from 20 m before the stop line to this many metres past it, one a metre."""
    approach = next(one for one in load_town(trial.town).detail({}).approaches if one.id == trial.approach)
    x, y = approach.stop_line
    along = [step - 20.0 for step in range(21 + round(metres))]
    return [(x + s * math.cos(approach.heading), y + s * math.sin(approach.heading)) for s in along]


def driven_run(ending: Ending, *, suite: str = "smoke@3", agent: str = "by hand", metres: float = 6.0) -> RunFile:
    """Return a run of a suite's open draw; twins, and trials that ``ending`` leaves out, take their exit."""
    episodes = []
    for number, trial in enumerate(load_suite(suite).open_draw.episodes):
        told = {"verdict": Verdict.EXIT_COMMANDED, "time": 5.0, "max_deceleration": 1.5, **ending(trial)}
        x, y = zip(*straight_on(trial, metres), strict=True)
        episodes.append(
            DrivenEpisode(
                id=f"ep_{number}",
                trial=trial.id,
                outcome=Outcome.model_validate(told),
                trajectory={"trial": trial.id, "x": list(x), "y": list(y)},
            )
        )
    return made_run(suite, episodes, suite, agent)
