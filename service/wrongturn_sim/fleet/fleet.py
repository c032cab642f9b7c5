"""A fleet: many cars (*egos*) of one town, each on its own trial, stepped together without SUMO.

Without other road users SUMO moves nothing that an episode reads. So observations, trajectories and verdicts have the
same bytes as those of :class:`~wrongturn_sim.episode.Episode`. With them, each ego has traffic of its own, which the
fleet drives itself (:mod:`~wrongturn_sim.fleet.traffic`).
"""

import hashlib
import itertools
import math
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from wrongturn_judge import JourneyGeometry, decide
from wrongturn_judge.judges import terms_of
from wrongturn_judge.outcomes import conclude, conclude_journey, journey_fields
from wrongturn_judge.packing import CLOCK_TOLERANCE
from wrongturn_judge.thresholds import THRESHOLDS
from wrongturn_judge.trajectory import RoadUser, Row, Trajectory
from wrongturn_networks import Town
from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults import CommandFault, closed_exit, fault_class, make_fault
from wrongturn_networks.faults.infeasible import Infeasible
from wrongturn_networks.faults.none import NoFault
from wrongturn_networks.faults.omission import Omission
from wrongturn_protocol import Outcome, Track, Trial
from wrongturn_protocol.observations import FIELDS, Observation
from wrongturn_sim import guide
from wrongturn_sim.ego import SUB_STEP, SUB_STEPS
from wrongturn_sim.errors import TrialNotAloneError
from wrongturn_sim.fleet import kernel
from wrongturn_sim.fleet.headway import WAITING
from wrongturn_sim.fleet.others import USER
from wrongturn_sim.fleet.tables import FleetTables, egos_for, with_rows
from wrongturn_sim.fleet.traffic import FleetTraffic, check_density, with_room
from wrongturn_sim.roads import roads_of
from wrongturn_sim.route import guidance_of, start_pose, start_route

_COMPILED: Final[dict[type[CommandFault], int]] = {
    NoFault: kernel.FAULT_NONE,
    Omission: kernel.FAULT_OMISSION,
    Infeasible: kernel.FAULT_INFEASIBLE,
}
"""Faults that the kernel delivers itself, for speed. Any other fault is asked in Python, one ego at a time."""
_ROUNDING: Final = 1e-6
"""A number of sub-steps that is too great by this much is that number: quotients of 0.05 s are not exact in binary."""
_PICTURES: Final = ("rgb", "segmentation")


@dataclass(frozen=True)
class Record:
    """The record of an ego's episode."""

    trajectory: Trajectory
    outcome: Outcome | None
    """None before there is a verdict."""
    actions_sha256: str
    """As :attr:`wrongturn_sim.episode.Episode.actions_sha256`."""


class Fleet:
    """A number of egos. :meth:`begin` starts their trials, :meth:`step` drives some or all of them.

    The arguments are those of :class:`~wrongturn_sim.fleet.vector_env.WrongturnVectorEnv`. The track decides what
    observations show, except for pictures, which :class:`FleetCamera` makes. ``record`` keeps what :meth:`record`
    returns, 45 kB a minute for each ego. With ``drive_on`` the outcome is still that of the first row that decides it,
    and None if the drive is over before. To judge the whole drive by other thresholds, give the record's trajectory to
    :func:`wrongturn_judge.judge`.
    """

    def __init__(
        self,
        town: Town,
        count: int,
        track: Track,
        *,
        threads: int = 1,
        strict: bool = False,
        record: bool = True,
        drive_on: float | None = None,
        traffic: FleetTraffic | None = None,
    ) -> None:
        self.town = town
        self.count = count
        self.strict = strict
        self._recording = record
        self._traffic = traffic
        self._drive_on = 0 if drive_on is None else max(math.ceil(drive_on / SUB_STEP - _ROUNDING), 1)
        self.trials: list[Trial | None] = [None] * count
        self._faults: list[CommandFault | None] = [None] * count
        self._roads = roads_of(town)
        self._tables = FleetTables(town, self._drive_on)
        self.observation: Observation = {
            field.name: np.zeros((count, *field.shape), field.dtype)
            for field in FIELDS[track]
            if field.name not in _PICTURES
        }
        """(n, ...) for each key except pictures; each step overwrites it."""
        empty = {field.name: np.zeros((0, *field.shape), field.dtype) for field in FIELDS[Track.PRIVILEGED]}
        self._observations = kernel.Observations(**(empty | self.observation))
        self._egos = egos_for(count)
        self._met: list[list[tuple[RoadUser, ...]]] = [[] for _ in range(count)]
        edges = np.linspace(0, count, min(threads, count) + 1).astype(int).tolist()
        self._parts = list(itertools.pairwise(edges))
        self._pool = ThreadPoolExecutor(len(self._parts) - 1) if len(self._parts) > 1 else None

    @property
    def poses(self) -> NDArray[np.float64]:
        """View of x, y, yaw of the bodies' centres, (n, 3)."""
        return self._egos.state[:, :3]

    @property
    def steps(self) -> NDArray[np.int64]:
        """Number of decisions so far, (n,)."""
        return (self._egos.sub_steps + SUB_STEPS - 1) // SUB_STEPS

    @property
    def rewards(self) -> NDArray[np.float64]:
        """View of the last decision's rewards, (n,)."""
        return self._egos.rewards

    @property
    def ended(self) -> NDArray[np.bool_]:
        """Whether each ego's drive is over, (n,): it has its verdict, or drove on until its time was up."""
        if self._drive_on:
            return self._egos.sub_steps >= self._drive_on
        return self._judged("verdict").astype(np.bool_)

    @property
    def ran_out(self) -> NDArray[np.bool_]:
        """Whether each ego's time ran out, (n,)."""
        if self._drive_on:
            return self.ended
        return self._judged("ran_out").astype(np.bool_)

    def _judged(self, name: str) -> NDArray[np.int64]:
        """Return a field of the judges' states, (n,)."""
        return np.asarray(self._egos.judged.view(decide.STATE)[name][:, 0])

    @property
    def waits(self) -> NDArray[np.bool_]:
        """Whether other road users oblige each ego to stand or to creep, (n,)."""
        return self.permitted < WAITING

    @property
    def permitted(self) -> NDArray[np.float64]:
        """View of the speeds that other road users permit, (n,), m/s; inf where nobody is in the way."""
        return self._egos.others.of("permitted")

    @property
    def turns(self) -> NDArray[np.int64]:
        """Direction of each ego's route at the junction ahead or around it, (n,), also before its window; 0: none."""
        progress = self._egos.progress.view(guide.PROGRESS)[:, 0]
        gates = self._roads.gates[progress["leg"], np.maximum(progress["gate"], 0)]
        return np.where(progress["gate"] >= 0, gates["direction"], 0)

    def others(self, chosen: NDArray[np.integer[Any]]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return the road users that some egos (k,) see, for pictures.

        Returns:
            (m, 8): x, y, yaw, length, width, height, kind, colour, the egos' one after the other, each one's nearest
            first; and (k + 1,), where those of each ego begin.
        """
        others = self._egos.others
        seen = others.of("seen")[chosen]
        begins = np.concatenate(([0], np.cumsum(seen)))
        shown = np.arange(others.pictures.shape[1]) < seen[:, None]
        return others.pictures[chosen][shown], begins

    def begin(self, trials: Iterable[tuple[int, Trial]]) -> None:
        """Begin trials, each given with the number of its ego.

        Raises TrialNotAloneError if a trial has another town or scenery, or other road users although the fleet has no
        traffic; TrafficTooDenseError and FaultNotApplicableError as Episode; GeometryMismatchError or
        UnknownApproachError if a journey's goal or the approach is not in the town.
        """
        # Check all trials first: after a refusal nothing has changed.
        checked = [(i, self._checked(trial), make_fault(trial)) for i, trial in trials]
        terms = {
            i: terms_of(JourneyGeometry.of(self.town), trial, strict=self.strict)
            for i, trial, _ in checked
            if trial.journey is not None
        }
        self._reserve([trial for _, trial, _ in checked])
        egos = self._egos
        chosen = [i for i, _, _ in checked]
        for i, trial, fault in checked:
            self.trials[i] = trial
            self._faults[i] = fault
            egos.approaches[i] = self._tables.row_of(trial)
            egos.faults[i] = _COMPILED.get(type(fault), kernel.FAULT_OTHER)
            egos.routes[i] = int(trial.route)
            egos.watches[i] = trial.watch - CLOCK_TOLERANCE
            journey = trial.journey
            egos.journeys[i] = journey is not None
            egos.goals[i] = 0 if journey is None else self._tables.goal_of(journey.goal)
            egos.state[i] = (*start_pose(self.town, trial), trial.start.speed, 0.0)
            egos.draws[i] = start_route(self._roads, self.town, trial, egos.progress[i])
            if i in terms:
                egos.terms[i] = terms[i]
            if self._traffic is not None:
                self._traffic.set(egos.others, i, trial)
            self._met[i] = []
        egos.order[:] = np.argsort(egos.approaches, kind="stable")
        egos.todo[:] = kernel.REST
        egos.todo[chosen] = kernel.GUIDE
        self._run()
        self._deliver(chosen)
        egos.todo[chosen] = kernel.BEGIN
        self._run()
        if self._recording and egos.met.shape[2]:
            for i in chosen:
                self._note(i, 1)

    def step(self, actions: NDArray[np.float32], which: NDArray[np.bool_]) -> None:
        """Drive the egos of ``which`` (n,) for 0.1 s, or until their drive is over; none of them has ended.

        ``actions`` (n, 3) float32 are steer, throttle, brake, in their ranges.
        """
        egos = self._egos
        egos.actions[:] = actions
        egos.todo[:] = np.where(which, kernel.DRIVE, kernel.REST)
        self._run()
        self._deliver(np.flatnonzero(which & (egos.faults == kernel.FAULT_OTHER)).tolist())
        if self._recording and egos.met.shape[2]:
            for i in np.flatnonzero(which).tolist():
                self._note(i, int(egos.sub_steps[i]) + 1 - len(self._met[i]))

    def _note(self, i: int, rows: int) -> None:
        """Keep whom an ego met in the last rows, for its record."""
        egos = self._egos
        for k in range(rows):
            users = egos.met[i, k, : egos.meetings[i, k]].tolist()
            self._met[i].append(tuple(tuple(user) for user in users))

    def outcome(self, i: int) -> Outcome | None:
        """Return the outcome of an ego's episode; None before there is a verdict."""
        trial, row = self.trials[i], self._egos.judged[i]
        if trial is None or not self._judged("verdict")[i]:
            return None
        geometry = self._tables.geometries[int(self._egos.approaches[i])]
        if isinstance(geometry, JourneyGeometry):
            return conclude_journey(row, trial)
        return conclude(row, trial, geometry, THRESHOLDS)

    def outcome_fields(self, i: int) -> dict[str, Any]:
        """Return an ego's outcome as a dict for JSON, without fields that are None; empty before there is a verdict."""
        trial = self.trials[i]
        if trial is not None and trial.journey is not None and self._judged("verdict")[i]:
            return journey_fields(self._egos.judged[i], trial)
        outcome = self.outcome(i)
        return {} if outcome is None else outcome.model_dump(mode="json", exclude_none=True)

    def record(self, i: int) -> Record:
        """Return the record of an ego's episode so far. Raises ValueError if none has begun, or none is kept."""
        if not self._recording:
            raise ValueError("record: this environment keeps none; make it with record=True")
        trial = self.trials[i]
        if trial is None:
            raise ValueError(f"environment {i}: it has begun no trial; call reset")
        egos = self._egos
        count = int(egos.sub_steps[i])
        decisions = -(-count // SUB_STEPS)
        inputs = egos.inputs[i, :decisions]
        commands = egos.commands[i].tolist()
        states = egos.states[i, : count + 1].tolist()
        actions = inputs.tolist()
        numbers = [(0.0, *states[0], *commands[0], 0.0, 0.0, 0.0)]
        for k in range(count):
            decision = k // SUB_STEPS
            numbers.append(((k + 1) / kernel.PER_SECOND, *states[k + 1], *commands[decision], *actions[decision]))
        met: list[tuple[RoadUser, ...]] = self._met[i] or [()] * len(numbers)
        rows = [Row._make((*row, users)) for row, users in zip(numbers, met, strict=True)]
        sha256 = hashlib.sha256(inputs.astype("<f4").tobytes()).hexdigest()
        return Record(Trajectory(trial, self.town.sha256, rows), self.outcome(i), sha256)

    def view(self, i: int) -> NDArray[np.uint8]:
        """Return a picture of an ego's moment for people, as ``Episode.view``. Raises ValueError as :meth:`record`."""
        from wrongturn_sim.replay import Replay  # noqa: PLC0415 - OpenCV is slow, and only pictures need it

        record = self.record(i)
        decision = -(-int(self._egos.sub_steps[i]) // SUB_STEPS)
        command, route_command = self._egos.commands[i, decision].tolist()
        return Replay(record.trajectory, record.outcome).last_view(command, route_command)

    def close(self) -> None:
        """Stop the threads."""
        if self._pool is not None:
            self._pool.shutdown()
            self._pool = None

    def _checked(self, trial: Trial) -> Trial:
        if trial.town != self.town.name:
            raise TrialNotAloneError(
                f"trial.town: {trial.town} is not {self.town.name}, where these cars drive; make another environment"
            )
        if trial.scenery != self.town.scenery_seed:
            raise TrialNotAloneError(
                f"trial.scenery: {trial.scenery} is not that of these cars' town, {self.town.scenery_seed}; "
                "make another environment"
            )
        if closed_exit(trial) is not None or issubclass(fault_class(trial.fault.kind), Disturbance):
            raise TrialNotAloneError(
                f"trial.fault: {trial.fault.kind} changes the town, or one car; the cars of one batch are alike; "
                "take another fault, 'wrongturn run' or gymnasium.vector.AsyncVectorEnv of single environments"
            )
        if self._traffic is not None:
            check_density(self.town, trial)
        elif trial.traffic.vehicles or trial.traffic.pedestrians:
            raise TrialNotAloneError(
                "trial.traffic: the cars of one batch drive alone; take a trial without other road users, "
                "or gymnasium.vector.AsyncVectorEnv of single environments"
            )
        self.town.approach(trial.approach)
        return trial

    def _run(self) -> None:
        """Run the kernel for all egos, shared among the threads; this thread takes the first part."""
        tables = self._tables.packed
        if self._pool is None:
            kernel.run(tables, self._egos, self._observations, 0, self.count)
            return
        (first, end), *others = self._parts
        waiting = [self._pool.submit(kernel.run, tables, self._egos, self._observations, *part) for part in others]
        kernel.run(tables, self._egos, self._observations, first, end)
        for part in waiting:
            part.result()

    def _deliver(self, chosen: Sequence[int]) -> None:
        """Ask the faults that are not compiled for their command; the route's is known already."""
        egos = self._egos
        for i in chosen:
            if egos.faults[i] != kernel.FAULT_OTHER:
                continue
            fault = self._faults[i]
            assert fault is not None
            told = guide.passages(*self._roads.tables[2:], egos.progress[i])
            lateral, heading = egos.beside[i].tolist()
            guidance = guidance_of(self._roads, int(egos.guided[i, 0]), lateral, heading, told)
            count = int(egos.sub_steps[i])
            command = int(fault.deliver(count / kernel.PER_SECOND, guidance))
            egos.delivered[i] = command
            if self._recording:
                egos.commands[i, -(-count // SUB_STEPS), 0] = command
            self.observation["command"][i, 0] = command

    def _reserve(self, trials: Sequence[Trial]) -> None:
        """Make room for the judge, the record and the road users; what is there already stays."""
        others = with_room(self._egos.others, trials)
        if others is not self._egos.others:
            most = others.users.shape[1] if self._recording else 0
            self._egos = self._egos._replace(others=others, met=np.zeros((self.count, SUB_STEPS, most, USER)))
        limits = [(trial.journey.time_limit if trial.journey else None) for trial in trials]
        rows: dict[str, int] = {}
        if None in limits:
            rows["history"] = math.ceil(THRESHOLDS.time_limit / SUB_STEP) + 1
        if self._recording:
            longest = max((THRESHOLDS.time_limit if limit is None else limit for limit in limits), default=0.0)
            sub_steps = max(math.ceil(longest / SUB_STEP), self._drive_on) + SUB_STEPS
            decisions = -(-sub_steps // SUB_STEPS)
            rows |= {"states": sub_steps + 1, "commands": decisions + 1, "inputs": decisions}
        self._egos = with_rows(self._egos, rows)
