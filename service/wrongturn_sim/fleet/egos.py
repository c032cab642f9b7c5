"""The arrays of a fleet's egos, and the room in them."""

from typing import Any

import numpy as np

from wrongturn_judge import decide
from wrongturn_judge.journey_kernels import JOURNEY_FLOATS, JOURNEY_INTS, TERMS
from wrongturn_sim import guide
from wrongturn_sim.ego import SUB_STEPS
from wrongturn_sim.fleet import kernel
from wrongturn_sim.fleet.others import USER, others_for


def egos_for(count: int) -> kernel.Egos:
    """Return ``count`` egos, without room yet for the judge's history, records and other road users."""
    return kernel.Egos(
        order=np.arange(count),
        todo=np.zeros(count, np.int8),
        approaches=np.zeros(count, np.int64),
        faults=np.zeros(count, np.int64),
        routes=np.zeros(count, np.int64),
        journeys=np.zeros(count, np.bool_),
        goals=np.zeros(count, np.int64),
        terms=np.zeros((count, TERMS)),
        actions=np.zeros((count, 3)),
        state=np.zeros((count, 5)),
        standing=np.zeros((count, JOURNEY_FLOATS)),
        counts=np.zeros((count, JOURNEY_INTS), np.int64),
        history=np.zeros((count, 0, decide.HISTORY)),
        draws=np.zeros((count, guide.DRAWS), np.uint32),
        progress=np.zeros((count, guide.PROGRESS_INTS), np.int64),
        places=np.zeros((count, guide.PROGRESS_FLOATS)),
        guided=np.zeros((count, 2), np.int64),
        beside=np.zeros((count, 3)),
        delivered=np.zeros(count, np.int64),
        sub_steps=np.zeros(count, np.int64),
        rewards=np.zeros(count),
        states=np.zeros((count, 0, 5)),
        commands=np.zeros((count, 0, 2), np.int8),
        inputs=np.zeros((count, 0, 3), np.float32),
        others=others_for(count, 0, 0),
        met=np.zeros((count, SUB_STEPS, 0, USER)),
        meetings=np.zeros((count, SUB_STEPS), np.int64),
    )


def with_rows(egos: kernel.Egos, rows: dict[str, int]) -> kernel.Egos:
    """Return egos whose named arrays have so many rows or more for each ego; what is there already stays."""
    grown: dict[str, Any] = {}
    for name, count in rows.items():
        before = getattr(egos, name)
        if before.shape[1] < count:
            grown[name] = np.zeros((before.shape[0], count, before.shape[2]), before.dtype)
            grown[name][:, : before.shape[1]] = before
    return egos._replace(**grown)
