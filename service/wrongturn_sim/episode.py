"""Episodes: one drive of one trial, in SUMO."""

import hashlib
import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING, Final, NamedTuple, SupportsFloat

import numpy as np
from pydantic import ValidationError

from wrongturn_faults.rules import Guidance
from wrongturn_judge import JourneyGeometry, JudgeGeometry, judge_of
from wrongturn_judge.trajectory import RoadUser, Row, Trajectory
from wrongturn_networks import town_of
from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults import CommandFault, make_fault
from wrongturn_protocol import Command, Outcome, Rig, Sight, Track, Trial, View
from wrongturn_protocol.observations import ROAD_USERS, Observation
from wrongturn_sim.ego import SUB_STEP, SUB_STEPS, State, advance
from wrongturn_sim.errors import (
    EpisodeAlreadyFinishedError,
    EpisodeNotStartedError,
    InvalidActionError,
    InvalidTrialError,
)
from wrongturn_sim.navigation import Planner
from wrongturn_sim.reward import reward
from wrongturn_sim.route import Navigator, start_pose
from wrongturn_sim.simulator import Simulation, Simulator
from wrongturn_sim.traffic.plan import EGO_LENGTH, TrafficPlan, plan_traffic

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from wrongturn_sim.camera import Camera, Renderer
    from wrongturn_sim.camera.renderer import Image
    from wrongturn_sim.eyes import Eyes

_row: Final = tuple.__new__  # makes a Row without parsing arguments, which takes longer than the car's dynamics
_FLOAT32: Final = struct.Struct("<3f")
_PER_SECOND: Final = round(1 / SUB_STEP)
_RANGES: Final = {"steer": (-1.0, 1.0), "throttle": (0.0, 1.0), "brake": (0.0, 1.0)}


class Step(NamedTuple):
    """Result of a step."""

    observation: Observation
    reward: float
    """Reward of practice and training; it does not count for scores."""
    terminated: bool
    """Whether a verdict other than running out of time was reached."""
    truncated: bool
    """Whether the time ran out."""


def _check_trial(trial: Trial) -> None:
    """Check the fields of a trial again, because ``model_copy`` lets anything through."""
    try:
        Trial.model_validate(trial.model_dump(warnings=False))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        path = ".".join(("trial", *map(str, first["loc"])))
        raise InvalidTrialError(
            f"{path}: {first['msg']}; make trials by draw_trial, or check yours by Trial.model_validate"
        ) from error


def _check_action(steer: SupportsFloat, throttle: SupportsFloat, brake: SupportsFloat) -> None:
    """Raise InvalidActionError, which names the field, if one is not a number or out of range."""
    for (name, (low, high)), value in zip(_RANGES.items(), (steer, throttle, brake), strict=True):
        try:
            if isinstance(value, str):
                raise TypeError
            right = low <= float(value) <= high
        except (TypeError, ValueError):
            raise InvalidActionError(
                f"action.{name}: {value!r} is not a number; give one from {low:g} to {high:g}"
            ) from None
        if not right:
            raise InvalidActionError(f"action.{name}: is {float(value)}; give a number from {low:g} to {high:g}")


def observe_state(state: State, command: Command) -> Observation:
    """Return the keys that all tracks have, as new arrays."""
    # The fastest way to make a new array is to fill an empty one.
    speed, steering, named = np.empty(1, np.float32), np.empty(1, np.float32), np.empty(1, np.int64)
    speed[0], steering[0], named[0] = state[3], state[4], command
    return {"speed": speed, "steering": steering, "command": named}


def observe_privileged(
    state: State, command: Command, navigator: Navigator, road_users: Sequence[RoadUser]
) -> Observation:
    """Return all keys of the privileged track, as new arrays; they reveal neither the route nor the fault."""
    observation = observe_state(state, command)
    exits, mask = navigator.exits()
    users = np.zeros((ROAD_USERS, 6), np.float32)
    count = min(len(road_users), ROAD_USERS)
    if count:
        users[:count] = road_users[:count]
    observation.update(
        pose=np.array(state[:3], np.float64),
        lane=navigator.lane_ahead(),
        stop_line=np.array((navigator.stop_line,), np.float32),
        exits=exits,
        exits_mask=mask,
        road_users=users,
        road_users_count=np.array((count,), np.int64),
    )
    return observation


class Episode:
    """One drive of one trial: ``reset``, then ``step`` until it says terminated or truncated.

    The same trial and actions give the same bytes of observations, trajectory and outcome, whatever this process drove
    before.

    ``sight``, a track or a rig, decides what observations show; a rig also has its rate of decisions. ``camera`` is the
    place and optics of a track's camera; the benchmark's by default. With ``compressed``, pictures that a rig wants as
    JPEGs are lists of JPEGs, as :func:`~wrongturn_protocol.observations.encode` takes them. ``simulator`` is the
    process's, if the caller keeps one. ``strict`` is for training: a journey ends when the car leaves its road or lane,
    or stands. With ``mirrored``, SUMO also carries a car that drives alone, as in the service; nothing that the episode
    returns depends on it.

    Raises:
        InvalidTrialError: a field of the trial is invalid.
        FaultNotApplicableError: the fault is not installed, or cannot be applied to the trial.
        TrafficTooDenseError: the town has no room for so many road users.
    """

    def __init__(
        self,
        trial: Trial,
        sight: Sight,
        *,
        simulator: Simulator | None = None,
        camera: "Camera | None" = None,
        strict: bool = False,
        mirrored: bool = False,
        compressed: bool = False,
    ) -> None:
        _check_trial(trial)
        self.trial = trial
        self.sight = sight
        self.town = town_of(trial)
        self.strict = strict
        self.geometry = JudgeGeometry.of(self.town, trial) if trial.journey is None else JourneyGeometry.of(self.town)
        self._fault: CommandFault = make_fault(trial)
        self._traffic = plan_traffic(self.town, trial, start_pose(self.town, trial))
        self._simulator = simulator or Simulator()
        edge = self.town.lanes[self.town.approach(trial.approach).lane].edge
        self._in_sumo = self._traffic or (TrafficPlan((), (), (edge,)) if mirrored else None)
        self._privileged = sight is Track.PRIVILEGED
        self._rate = sight.rate if isinstance(sight, Rig) else 10
        self._disturbance = self._fault if isinstance(self._fault, Disturbance) else None
        self._renderer = self._eye(camera) if sight in {Track.CAMERA, Track.SEGMENTATION, Track.WORDS} else None
        self._eyes = self._eyes_of(sight, compressed=compressed) if isinstance(sight, Rig) and sight.cameras else None
        self._planner: Planner | None = None
        self._simulation: Simulation | None = None
        self._actions: list[bytes] = []
        self.trajectory = Trajectory(trial, self.town.sha256)
        self.outcome: Outcome | None = None
        self.steps = 0
        """Number of decisions so far."""

    def reset(self) -> Observation:
        """Begin the trial, or begin it again, and return the first observation.

        Raises:
            SimulatorUnavailableError: libsumo cannot be loaded.
            SimulatorFailedError: SUMO reported an error.
        """
        trial = self.trial
        pose = start_pose(self.town, trial)
        if self._in_sumo is None:
            self._simulation = Simulation()
        else:
            self._simulation = self._simulator.begin(self.town.net_file, *pose, self._in_sumo, seed=trial.seed)
        self._state: State = (*pose, trial.start.speed, 0.0)
        self._navigator = Navigator(self.town, trial)
        self._fault = make_fault(trial)
        self._disturbance = self._fault if isinstance(self._fault, Disturbance) else None
        if self._disturbance is not None:
            self._disturbance.rate = self._rate
        if isinstance(self.sight, Rig) or self.sight is Track.WORDS:
            self._planner = Planner(self.sight, trial, self._fault, self._navigator)
        if self._eyes is not None:
            self._eyes.forget()
        self._judge = judge_of(self.geometry, trial, strict=self.strict)
        self._actions = []
        self.trajectory = Trajectory(trial, self.town.sha256, appearances=self._simulation.appearances)
        self.steps = self._sub_steps = 0
        # On a journey: the edges that others expect the car to take, from the one that it is on.
        self._expected = self._traffic.ego if self._traffic is not None and trial.journey is not None else ()
        self._outdated = False
        self._guide()
        users = self._simulation.road_users()
        row = Row(0.0, *self._state, int(self._command), int(self._guidance.command), 0.0, 0.0, 0.0, users)
        self.trajectory.rows.append(row)
        if self._traffic is not None:
            self.trajectory.road_user_numbers.append(self._simulation.numbers())
        self.outcome = self._judge.observe(row)
        return self._observe()

    def step(self, steer: float, throttle: float, brake: float) -> Step:
        """Drive until the next decision, 0.1 s or 0.05 s by the rig's rate, or until there is a verdict.

        Steer is -1 (full left) to 1 (full right); throttle and brake are 0 to 1, and the brake overrides the throttle.

        Raises:
            InvalidActionError: a field is not a finite number in its range.
            EpisodeNotStartedError: call ``reset`` first.
            EpisodeAlreadyFinishedError: the episode has its outcome.
            SimulatorInUseError: another episode of this process took the simulator.
            SimulatorFailedError: SUMO reported an error.
        """
        self._advance(steer, throttle, brake)
        truncated = self._judge.ran_out
        return Step(
            self._observe(),
            reward(self._state[3], self._state[2], self._guidance),
            self.outcome is not None and not truncated,
            truncated,
        )

    def repeat(self, actions: Sequence[tuple[float, float, float]]) -> Step | None:
        """Take many steps and return the last one's result; None if there are no actions.

        Only the last observation is made, so this is faster than calling :meth:`step`, whose errors it raises. A
        disturbance and a rig's cameras, which remember, see all of them.
        """
        if not actions:
            return None
        for action in actions[:-1]:
            self._advance(*action)
            if self._disturbance is not None or self._eyes is not None:
                self._observe()
        return self.step(*actions[-1])

    def _advance(self, steer: float, throttle: float, brake: float) -> None:
        simulation = self._begun("step")
        if self.outcome is not None:
            raise EpisodeAlreadyFinishedError(f"the episode ended in {self.outcome.verdict}; call reset to drive again")
        try:
            if not (-1.0 <= steer <= 1.0 and 0.0 <= throttle <= 1.0 and 0.0 <= brake <= 1.0):
                _check_action(steer, throttle, brake)
            action = _FLOAT32.pack(steer, throttle, brake)
        except (TypeError, ValueError, struct.error):
            _check_action(steer, throttle, brake)
            raise
        steer, throttle, brake = _FLOAT32.unpack(action)

        state = self._state
        rows = self.trajectory.rows
        command = int(self._command)
        route_command = int(self._guidance.command)
        turned = steer if self._disturbance is None else self._disturbance.steered(steer)
        for _ in range(_PER_SECOND // self._rate):
            state = advance(*state, turned, throttle, brake, SUB_STEP)
            simulation.move(state[0], state[1], state[2])
            self._sub_steps += 1
            t = self._sub_steps / _PER_SECOND
            row = _row(Row, (t, *state, command, route_command, steer, throttle, brake, simulation.road_users()))
            rows.append(row)
            if self._traffic is not None:
                self.trajectory.road_user_numbers.append(simulation.numbers())
            self.outcome = self._judge.observe(row)
            if self.outcome is not None:
                break
        self._state = state
        self._actions.append(action)
        self.steps += 1
        self._guide()

    def abort(self) -> Outcome:
        """End the episode as ``aborted``, unless it has ended; return its outcome. Raises EpisodeNotStartedError."""
        self._begun("abort")
        if self.outcome is None:
            self.outcome = self._judge.abort(self.trajectory.rows[-1].t)
        return self.outcome

    @property
    def actions_sha256(self) -> str:
        """SHA-256 of the actions as little-endian float32 (n, 3), steer, throttle, brake; hexadecimal."""
        return hashlib.sha256(b"".join(self._actions)).hexdigest()

    def _guide(self) -> None:
        """Ask the route and the fault for the command until the next decision."""
        self._guidance: Guidance = self._navigator.update(self._state[0], self._state[1])
        self._command: Command = self._fault.deliver(self._sub_steps / _PER_SECOND, self._guidance)
        fork = self.trial.fork
        if fork is not None and self._sub_steps >= fork.decision * SUB_STEPS:
            self._command = self._guidance.command if fork.command is None else fork.command
        if self._expected:
            self._update_expected_route()

    def _update_expected_route(self) -> None:
        """Tell SUMO's drivers where the car goes now, if it left its route."""
        edge = self.town.lanes[self._navigator.lane].edge
        if edge != self._expected[0]:
            self._expected = self._expected[1:]
            if not self._expected or edge != self._expected[0]:
                lanes = self._navigator.lanes_ahead(EGO_LENGTH)
                self._expected = tuple(self.town.lanes[lane].edge for lane in lanes)
                self._outdated = True
        if self._outdated:
            self._outdated = not self._begun("step").set_route(self._expected)

    def _observe(self) -> Observation:
        observation = self._senses()
        return observation if self._disturbance is None else self._disturbance.sensed(observation, self.steps)

    def _senses(self) -> Observation:
        if self._privileged:
            users = self._begun("step").road_users()
            return observe_privileged(self._state, self._command, self._navigator, users)
        observation = observe_state(self._state, self._command)
        if self._planner is not None:
            del observation["command"]
            told = self._planner.told(self._sub_steps / _PER_SECOND, self._guidance, self._command, self._state)
            observation.update(told)
        if self._eyes is not None:
            others = self._begun("step").others()
            observation.update(self._eyes.look(self._state[:3], self.steps, others, self._developed))
        if self._renderer is not None:
            rgb, segmentation = self._seen_by(self._renderer)
            pictures = {"rgb": rgb, "segmentation": segmentation}
            if self.sight is not Track.SEGMENTATION:
                del pictures["segmentation"]
            observation.update(self._developed(pictures, self.steps))
        return observation

    def _developed(self, pictures: Observation, decision: int) -> Observation:
        return pictures if self._disturbance is None else self._disturbance.developed(pictures, decision)

    def view(self, view: View | str = View.BOTH, size: int | None = None, camera: "Camera | None" = None) -> "Image":
        """Return a picture of the moment for people, RGB uint8; its shape is that of :meth:`Replay.frames`.

        The view from above follows the car; its side is ``size`` pixels, 480 by default. It shows the route and the
        other road users, which agents may not see. The camera is the benchmark's by default.

        Raises:
            EpisodeNotStartedError: call ``reset`` first.
            ViewError: The view is unknown, or the size is too small or too large.
        """
        from wrongturn_sim.view.views import VIEW_SIZE, Moment, Views, view_of  # noqa: PLC0415 - slow, and only pictures need it

        self._begun("view")
        rows, view = self.trajectory.rows, view_of(view)
        seen = None if view is View.TOP else self._seen_by(self._renderer_of(camera))[0]
        now = Moment(len(rows) - 1, self._command, self._guidance.command, seen, self.outcome)
        return Views(self.town, self.trial, rows, size or VIEW_SIZE, still=False).draw(view, now)

    def plot(self) -> "Figure":
        """Return the drive so far as :meth:`Replay.plot`; raises as that, and EpisodeNotStartedError before a reset."""
        from wrongturn_sim.view.plot import plot_episode  # noqa: PLC0415 - as above

        self._begun("plot")
        return plot_episode(self.town, self.trajectory, self.outcome)

    def _eye(self, camera: "Camera | None") -> "Renderer":
        """Return the renderer of observations."""
        from wrongturn_sim.camera import Camera  # noqa: PLC0415 - slow, and only pictures need it

        return self._renderer_of(self._disturbance.mounted(camera or Camera()) if self._disturbance else camera)

    def _eyes_of(self, rig: Rig, *, compressed: bool) -> "Eyes":
        from wrongturn_sim.eyes import Eyes  # noqa: PLC0415 - as above

        return Eyes(rig, self._eye, compressed=compressed)

    def _renderer_of(self, camera: "Camera | None") -> "Renderer":
        from wrongturn_sim.camera import Renderer, World  # noqa: PLC0415 - slow, and only pictures need it

        return Renderer(World.of(self.town), camera, self.trial.weather, self.trial.seed)

    def _seen_by(self, renderer: "Renderer") -> "tuple[Image, Image]":
        return renderer.render(*self._state[:3], self.steps, self._begun("view").others())

    def _begun(self, what: str) -> Simulation:
        """Return the simulation; raise EpisodeNotStartedError before the first reset."""
        if self._simulation is None:
            raise EpisodeNotStartedError(f"{what} before the first reset; call reset")
        return self._simulation
