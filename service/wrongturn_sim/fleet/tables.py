"""The arrays of a fleet's kernel: the egos, and what it does not change: roads, streets, ways, what the judge knows."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge import JourneyGeometry, JudgeGeometry, decide
from wrongturn_judge.compiling import words
from wrongturn_judge.journey_kernels import TERMS
from wrongturn_judge.kernels import HEAD
from wrongturn_judge.packing import numbers_of
from wrongturn_networks import Town
from wrongturn_protocol import Trial
from wrongturn_sim import guide
from wrongturn_sim.ego import SUB_STEPS
from wrongturn_sim.fleet import kernel
from wrongturn_sim.fleet.others import USER, others_for
from wrongturn_sim.fleet.streets import streets_of
from wrongturn_sim.roads import roads_of
from wrongturn_sim.route import way_to


class FleetTables:
    """The tables of a fleet in one town. They grow with the approaches and goals of its trials.

    Each drive is over after ``drive_on`` sub-steps; 0 ends it with its verdict.
    """

    def __init__(self, town: Town, drive_on: int) -> None:
        self._town, self._drive_on = town, drive_on
        self._roads = roads_of(town)
        self._rows: dict[str, int] = {}
        self.geometries: list[JudgeGeometry | JourneyGeometry] = []
        """The geometry of each row."""
        self._goals: dict[str | None, int] = {None: 0}
        self._packed = self._made()

    def row_of(self, trial: Trial) -> int:
        """Return the row of the geometry of a trial's approach, or of the town for a journey; add it if it is new."""
        name = trial.approach if trial.journey is None else ""
        if name not in self._rows:
            geometry = JudgeGeometry.of(self._town, trial) if trial.journey is None else JourneyGeometry.of(self._town)
            # The geometry comes first: without it, a row that an interruption left would lead the kernel astray.
            self.geometries.append(geometry)
            self._rows[name] = len(self.geometries) - 1
        return self._rows[name]

    def goal_of(self, goal: str | None) -> int:
        """Return the row of the ways to a goal; add it if it is new."""
        return self._goals.setdefault(goal, len(self._goals))

    @property
    def packed(self) -> kernel.Tables:
        """What the kernel reads. Approaches and goals that were added are in it."""
        if len(self._packed.bases) <= len(self.geometries) or len(self._packed.ways) < len(self._goals):
            self._packed = self._made()
        return self._packed

    def _made(self) -> kernel.Tables:
        places = [geometry.packed for geometry in self.geometries]
        sizes = np.array([(len(one.floats), len(one.ints), len(one.cells)) for one in places], np.int64).reshape(-1, 3)
        roads = self._roads

        def joined(arrays: list[Any], dtype: Any) -> Any:
            return np.concatenate([np.empty(0, dtype), *arrays])

        return kernel.Tables(
            *roads.tables,
            exits=roads.exits,
            exits_mask=roads.exits_mask,
            heads=np.array([one.head for one in places]).reshape(-1, words(HEAD)),
            floats=joined([one.floats for one in places], np.float64),
            ints=joined([one.ints for one in places], np.int64),
            cells=joined([one.cells for one in places], np.uint8),
            bases=np.concatenate([np.zeros((1, 3), np.int64), np.cumsum(sizes, axis=0)]),
            lanes=joined([one.lanes for one in self.geometries if isinstance(one, JourneyGeometry)], np.int16),
            ways=np.array([way_to(self._town, goal) for goal in self._goals]),
            rests=np.array([self._rest(goal) for goal in self._goals]),
            numbers=numbers_of(),
            streets=streets_of(self._town),
            drive_on=self._drive_on,
        )

    def _rest(self, goal: str | None) -> NDArray[np.float64]:
        if goal is None:
            return np.zeros(len(self._roads.lanes))
        return JourneyGeometry.of(self._town).rest(goal)


def egos_for(count: int) -> kernel.Egos:
    """Return ``count`` egos, without room yet for the judge's history, records and other road users."""
    return kernel.Egos(
        order=np.arange(count),
        todo=np.zeros(count, np.int8),
        approaches=np.zeros(count, np.int64),
        faults=np.zeros(count, np.int64),
        routes=np.zeros(count, np.int64),
        watches=np.zeros(count),
        journeys=np.zeros(count, np.bool_),
        goals=np.zeros(count, np.int64),
        terms=np.zeros((count, words(TERMS))),
        actions=np.zeros((count, 3)),
        state=np.zeros((count, 5)),
        judged=np.zeros((count, words(decide.STATE))),
        history=np.zeros((count, 0, words(decide.MOMENT))),
        draws=np.zeros((count, guide.DRAWS), np.uint32),
        progress=np.zeros((count, words(guide.PROGRESS))),
        guided=np.zeros((count, 2), np.int64),
        beside=np.zeros((count, 2)),
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
