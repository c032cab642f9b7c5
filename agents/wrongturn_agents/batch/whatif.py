"""What if: a stored drive again, with another command from one decision on."""

import struct
from dataclasses import dataclass
from typing import Final

from wrongturn_agents.batch.group import loaded
from wrongturn_agents.errors import RunError
from wrongturn_agents.whatif_file import Difference, ForkResult, SweepResult
from wrongturn_agents.worker import GuardedAgent
from wrongturn_faults.rules import DECISIONS
from wrongturn_judge import Trajectory, TrajectoryError
from wrongturn_protocol import Command, Fork, Rig, Sight, Verdict
from wrongturn_protocol.observations import Observation, observation_space
from wrongturn_protocol.vehicle import DECISION_S
from wrongturn_protocol.vocabulary import Safety
from wrongturn_sim.ego import SUB_STEPS
from wrongturn_sim.episode import Episode
from wrongturn_sim.errors import EpisodeAlreadyFinishedError

_FLOAT32: Final = struct.Struct("<3f")
_Act = tuple[float, float, float]


class WhatIf:
    """A stored drive that can be forked at any decision.

    The car repeats the stored actions up to the fork, so all bytes before it are the stored ones. The agent is shown
    the same observations from the start, for its memory, and its actions are compared with the stored ones.

    Raises:
        RunError: The trajectory is a fork itself, or cannot be repeated here.
        AgentsError: The agent fails.
        SimError, NetworkError: The simulation fails, or the town cannot be loaded.
    """

    def __init__(self, stored: Trajectory, agent: GuardedAgent, sight: Sight) -> None:
        if isinstance(sight, Rig) and sight.rate != DECISIONS:
            raise RunError(f"agent: decides {sight.rate} times a second; give one that decides {DECISIONS} times")
        try:
            stored.check_rows()
        except TrajectoryError as error:
            raise RunError(str(error)) from error
        if stored.trial.fork is not None:
            raise RunError("the episode is a fork itself; fork the episode that it comes from")
        self.stored, self.trial = stored, stored.trial
        self.actions = actions_of(stored)
        """The stored actions: steer, throttle, brake for each decision."""
        self.differs: Difference | None = None
        """The first action of the agent that is not the stored one."""
        self._agent, self._sight, self._space = agent, sight, observation_space(sight)
        self._seen: list[Observation] = []
        self.verdict = self._repeat()
        """The stored drive's verdict; None if it ended without one, as when the agent aborted it."""

    def fork(self, decision: int, command: Command | None) -> Episode:
        """Drive a fork to its end and return it.

        Args:
            decision: The first one with the other command; 0 is the reset.
            command: The command from then on. None: the route's.
        """
        if not 0 <= decision < len(self.actions):
            last = (len(self.actions) - 1) * DECISION_S
            raise RunError(f"--at: is outside the drive, whose last decision is at {last:.1f} s; give 0 to {last:.1f}")
        fork = Fork(decision=decision, command=command)
        episode = Episode(self.trial.model_copy(update={"fork": fork}), self._sight)
        seen = episode.reset()
        self._agent.reset(self._space)
        for earlier in range(0 if self._agent.memoryless else decision):
            self._act(earlier, self._seen[earlier])
        step = episode.repeat(self.actions[:decision])
        if step is not None:
            seen = step.observation
            self._check_rows(episode.trajectory, decision * SUB_STEPS + 1)
        while episode.outcome is None:
            action = self._agent.act(seen)
            seen = episode.step(action.steer, action.throttle, action.brake).observation
        return episode

    def forked(self, at: float, command: Command | None) -> ForkResult:
        """Drive a fork from the first decision at or after a time on, and return what it shows."""
        decision = decision_at(at)
        episode = self.fork(decision, command)
        assert episode.outcome is not None
        return ForkResult(
            at=_seconds(decision),
            command=command,
            was=self.verdict,
            outcome=episode.outcome,
            reacts_s=self._first_other(episode.trajectory),
            differs=self.differs,
        )

    def sweep(self, every: float) -> SweepResult:
        """Return until when the right command would have helped, and what the agent noticed.

        Whether a fork ends safely need not depend on its time in one direction only, so nothing is bisected. From the
        end back, a fork each ``every`` seconds is driven until one is safe, then each decision between that one and the
        next, again from the end. Safety that comes back for less than ``every`` seconds is missed; 0.1 misses none.
        """
        rows = self.stored.rows[1::SUB_STEPS]
        first = next((k for k, row in enumerate(rows) if row.command != row.route_command), None)
        verdicts: dict[int, Verdict] = {}
        detected, last = None, None
        if first is not None:
            right = self.fork(first, None)
            assert right.outcome is not None
            verdicts[first] = right.outcome.verdict
            detected = self._first_other(right.trajectory)
            if self.verdict is None or self.verdict.safety is not Safety.SAFE:
                last = self._last_safe(first, max(1, round(every / DECISION_S)), verdicts)
        return SweepResult(
            trial=self.trial.id,
            verdict=self.verdict,
            wrong_s=None if first is None else _seconds(first),
            right=self.verdict if first is None else verdicts[first],
            detection_s=detected,
            no_return_s=None if last is None else _seconds(last),
            forks=tuple((_seconds(k), verdicts[k]) for k in sorted(verdicts)),
            differs=self.differs,
        )

    def _last_safe(self, first: int, every: int, verdicts: dict[int, Verdict]) -> int | None:
        """Return the last decision from which the right command ends safely, as :meth:`sweep` says."""

        def safe(decision: int) -> bool:
            if decision not in verdicts:
                outcome = self.fork(decision, None).outcome
                assert outcome is not None
                verdicts[decision] = outcome.verdict
            return verdicts[decision].safety is Safety.SAFE

        found = next(filter(safe, reversed(range(first, len(self.actions), every))), None)
        if found is None:
            return None
        between = range(found + 1, min(found + every, len(self.actions)))
        return next(filter(safe, reversed(between)), found)

    def _repeat(self) -> Verdict | None:
        """Drive the stored actions again, and show the agent what they show."""
        episode = Episode(self.trial, self._sight)
        seen = episode.reset()
        self._agent.reset(self._space)
        for decision, action in enumerate(self.actions):
            self._act(decision, seen)
            if not self._agent.memoryless:
                self._seen.append(seen)
            try:
                seen = episode.step(*action).observation
            except EpisodeAlreadyFinishedError:
                break
        self._check_rows(episode.trajectory, len(self.stored.rows))
        return None if episode.outcome is None else episode.outcome.verdict

    def _act(self, decision: int, seen: Observation) -> None:
        action = self._agent.act(seen)
        now = _FLOAT32.unpack(_FLOAT32.pack(action.steer, action.throttle, action.brake))
        if self.differs is None and now != self.actions[decision]:
            self.differs = Difference(at=_seconds(decision), stored=self.actions[decision], now=now)

    def _check_rows(self, driven: Trajectory, count: int) -> None:
        """Check that so many rows are the stored ones."""
        if driven.town_sha256 != self.stored.town_sha256:
            raise RunError(
                f"the town {self.trial.town} here is not the one that was driven in; install the version of that drive"
            )
        if driven.rows[:count] != self.stored.rows[:count]:
            pairs = zip(driven.rows, self.stored.rows, strict=False)
            at = next((was.t for now, was in pairs if now != was), driven.rows[-1].t)
            raise RunError(
                f"the stored drive cannot be repeated here: it differs from {at:.2f} s on; install the version that "
                "drove it"
            )

    def _first_other(self, driven: Trajectory) -> float | None:
        """Return when a drive's action first differs from the stored one, seconds; None if none does."""
        pairs = zip(actions_of(driven), self.actions, strict=False)
        return next((_seconds(k) for k, (now, was) in enumerate(pairs) if now != was), None)


def actions_of(trajectory: Trajectory) -> list[_Act]:
    """Return a drive's actions: steer, throttle, brake for each decision."""
    return [(row.steer, row.throttle, row.brake) for row in trajectory.rows[1::SUB_STEPS]]


def decision_at(at: float) -> int:
    """Return the first decision at or after a time in seconds."""
    return -int(-(at / DECISION_S - 1e-6) // 1)


def _seconds(decision: int) -> float:
    return round(decision * DECISION_S, 1)


@dataclass(frozen=True)
class Sweep:
    """A drive that a worker sweeps."""

    agent: str
    """The agent, as :func:`wrongturn_agents.registry.resolve` takes it."""
    folder: str
    """Working directory of the command, where a class of the user's is found."""
    trajectory: bytes
    """JSON."""
    every: float
    """Seconds between the forks that are driven first."""


def whatif_of(agent: str, folder: str, trajectory: bytes) -> WhatIf:
    """Return a stored drive with its agent. Raises as :class:`WhatIf`, and RunError for what is no trajectory."""
    try:
        stored = Trajectory.from_json(trajectory)
    except TrajectoryError as error:
        raise RunError(str(error)) from error
    return WhatIf(stored, *loaded(agent, folder))


def sweep(task: Sweep) -> SweepResult:
    """Sweep one drive, as :meth:`WhatIf.sweep`."""
    return whatif_of(task.agent, task.folder, task.trajectory).sweep(task.every)
