"""Many cars of one town in one process, as one Gymnasium vector environment.

``gymnasium.make_vec("wrongturn_sim:WrongturnSim-v0", num_envs=64, town="Town01", track="camera", threads=2)``

It needs neither SUMO nor other processes. Each car drives alone, and its observations, trajectory and verdict have the
same bytes as in :class:`~wrongturn_sim.gym_env.WrongturnSimEnv`.
"""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from wrongturn_networks import Town, load_town
from wrongturn_protocol import OptionError, Track, Traffic, Trial, TrialKeywords, TrialOptions
from wrongturn_protocol.environments import Flags, TrialVectorEnv
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.trial_options import check_keywords, whole_number
from wrongturn_sim.errors import EpisodeAlreadyFinishedError, EpisodeNotStartedError, InvalidActionError
from wrongturn_sim.fleet.fleet import Fleet, Record
from wrongturn_sim.fleet.traffic import FleetTraffic
from wrongturn_sim.trial_source import TrialSource, a_flag, picture_size

if TYPE_CHECKING:
    from wrongturn_sim.camera import Camera, WeatherLook


class WrongturnVectorEnv(TrialVectorEnv):
    """Drive many trials at once, each with its own random generator and its own end.

    After ``reset(seed=s)``, environment ``i`` draws and drives the same trials as a single environment after
    ``reset(seed=s + i)``. ``infos`` holds ``trial`` and ``town`` where a trial began, ``verdict`` and ``outcome`` where
    one ended. As Gymnasium prescribes, masks stand beside them under ``_trial`` and so on.

    Args:
        num_envs: number of environments.
        town: town in which trials are drawn, by name or, for one that is not installed, as read; ``Town01`` by default.
        track: decides what observations show.
        camera: place and optics of the camera, in the tracks that have one; the benchmark's by default. A list has that
            of each environment.
        looks: for training: looks of the weather, such as ``[LOOKS[a].mixed(LOOKS[b], 0.5)]``. A trial's seed chooses
            one. The record and ``render`` keep the trial's weather. By default each weather has its own look.
        threads: number of threads that share a step's work; the bytes do not depend on it.
        backend: where pictures are rendered: ``cpu``, or ``cuda`` for an NVIDIA GPU. On a GPU they stay there:
            ``torch.as_tensor(observation["rgb"], device="cuda")`` shares their memory, and pictures in ``final_obs``
            last until the same environment ends again.
        strict: for training: a journey ends when the car leaves its road or lane, or stands.
        record: keep trajectories and actions for :meth:`episode`. Training does not need them; they take memory.
        drive_on: seconds after which each episode is truncated; no verdict ends it before. ``infos`` and the record
            still hold the verdict, if there was one. None: each episode ends with its verdict.
        own_traffic: let trials with ``traffic`` drive beside the batch's own simple traffic, for training:
            ``FleetTraffic()`` drives much like SUMO's, but it is not SUMO's. None: such trials are refused.
        autoreset_mode: when an environment that ended begins again: ``NextStep`` (that step ignores its action),
            ``SameStep`` (``infos["final_obs"]`` and ``["final_info"]`` hold the end), or ``Disabled`` (you call
            ``reset(options={"reset_mask": ...})``).
        copy: return new arrays; otherwise the next step overwrites those that are returned.
        render_mode: ``rgb_array``, to get pictures from ``render``, which are drawn from the record.
        options: ``approach``, ``fault``, ``task``, ``suite`` and so on; see :class:`~wrongturn_protocol.TrialOptions`.
            ``traffic`` needs ``own_traffic``, and all trials of a ``suite`` must have the same town.

    Raises:
        OptionError: a name does not exist, or two options exclude each other.
    """

    _NOT_BEGUN = EpisodeNotStartedError
    _ENDED = EpisodeAlreadyFinishedError
    _BAD_ACTION = InvalidActionError

    def __init__(
        self,
        num_envs: int = 1,
        town: str | Town | None = None,
        track: Track | str = Track.STATE,
        *,
        camera: "Camera | Sequence[Camera] | None" = None,
        looks: "Sequence[WeatherLook]" = (),
        threads: int = 1,
        backend: str = "cpu",
        strict: bool = False,
        record: bool = True,
        drive_on: float | None = None,
        own_traffic: FleetTraffic | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Unpack[TrialKeywords],
    ) -> None:
        check_keywords(WrongturnVectorEnv, options)
        whole_number("threads", threads)
        for name, flag in (("strict", strict), ("record", record), ("copy", copy)):
            a_flag(name, flag)
        if drive_on is not None and (not isinstance(drive_on, int | float) or not 0 < drive_on < math.inf):
            raise OptionError(f"drive_on: is {drive_on!r}; give seconds, more than 0 and finite, or None")
        if own_traffic is not None and not isinstance(own_traffic, FleetTraffic):
            raise OptionError(f"own_traffic: is {own_traffic!r}; give a FleetTraffic, such as FleetTraffic()")
        if backend not in ("cpu", "cuda"):
            raise OptionError(f"backend: is {backend!r}; give cpu or cuda")
        place = town if isinstance(town, Town) else None
        trials = TrialOptions.of(town.name if isinstance(town, Town) else town, track, **options)
        if trials.track is Track.WORDS:
            raise OptionError("track: a batch has no sentences; take single environments, or the track camera")
        self._prepare(num_envs, trials.track, autoreset_mode, render_mode, picture_size(camera, num_envs))
        if render_mode is not None and not record:
            raise OptionError("render_mode: pictures are drawn from the record; leave render_mode or record=False out")
        if trials.traffic != Traffic() and own_traffic is None:
            raise OptionError(
                "traffic: the cars of one batch drive alone; leave it out, take single environments, or give "
                "own_traffic=FleetTraffic() to drive beside the batch's own traffic"
            )
        self._source = TrialSource(trials, place)
        (name, scenery), *others = self._source.places
        if others:
            names = ", ".join(sorted({name, *(other for other, _ in others)}))
            raise OptionError(f"suite: {trials.suite} has trials in {names}; all cars need the same town")
        self.copy = copy
        self._fleet = Fleet(
            place or load_town(name, scenery),
            num_envs,
            self.track,
            threads=threads,
            strict=strict,
            record=record,
            drive_on=drive_on,
            traffic=own_traffic,
        )
        self._camera = None
        if self.track in {Track.CAMERA, Track.SEGMENTATION}:
            from wrongturn_sim.camera import WeatherLook  # noqa: PLC0415 - slow, and only pictures need it
            from wrongturn_sim.fleet import camera as pictures  # noqa: PLC0415 - slow, and only pictures need it

            if not isinstance(looks, list | tuple) or not all(isinstance(look, WeatherLook) for look in looks):
                raise OptionError("looks: give a list of wrongturn_sim.camera.WeatherLook")
            self._camera = pictures.FleetCamera(self._fleet, camera, self.track, threads, backend, looks)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the next trials.

        Args:
            seed: seed of the first generator, from which the others count up; or a list; None keeps the generators.
            options: ``trial``: drive this one (a Trial, or an id of the suite), or a list of them; ``reset_mask``, (n,)
                bool: begin only these.

        Raises:
            OptionError: the number of seeds, trials or flags is not that of the environments.
            SimError: as :class:`~wrongturn_sim.fleet.fleet.Fleet`.
        """
        asked = self._asked(seed, options, (str, Trial))
        infos: dict[str, Any] = {}
        self._begin([(i, self._draw(i, trial)) for i, trial in asked.items()], infos)
        return self._observation(), infos

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observation, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Drive for 0.1 s.

        Args:
            actions: (n, 3): steer, throttle, brake.

        Raises:
            InvalidActionError: a field is not a finite number in its range; no environment moved.
            EpisodeNotStartedError: call ``reset`` first.
            EpisodeAlreadyFinishedError: an environment has ended, and ``autoreset_mode`` is ``Disabled``.
        """
        given, driven = self._driven(actions)
        fleet = self._fleet
        fleet.step(given.astype(np.float32), driven)
        infos: dict[str, Any] = {}
        if not driven.all():
            self._begin([(i, self._draw(i)) for i in np.flatnonzero(~driven).tolist()], infos, render=False)
        if self._camera is not None:
            self._camera.render()
        rewards = fleet.rewards.copy()
        ended = fleet.ended & driven
        truncated = fleet.ran_out & driven
        self._over = ended.copy()
        if ended.any():
            self._finish(np.flatnonzero(ended).tolist(), infos)
        return self._observation(), rewards, ended & ~truncated, truncated, infos

    def episode(self, index: int) -> Record:
        """Return the trajectory of an environment's episode so far, and its outcome if it has ended.

        The record lasts until the environment's next episode begins; with ``SameStep`` that is at once. Raises
        OptionError if no episode has begun, or ``record`` is False.
        """
        return self._fleet.record(index)

    @property
    def steps(self) -> NDArray[np.int64]:
        """Number of decisions of each environment's episode so far, (n,)."""
        return self._fleet.steps

    @property
    def town(self) -> Town:
        """The town of all cars."""
        return self._fleet.town

    @property
    def poses(self) -> NDArray[np.float64]:
        """Where each car is, (n, 3): x and y of the body's centre in metres, and yaw in radians."""
        return self._fleet.poses

    @property
    def waits(self) -> NDArray[np.bool_]:
        """Whether other road users oblige each car to stand or to creep, (n,)."""
        return self._fleet.waits

    @property
    def trials(self) -> tuple[Trial | None, ...]:
        """Trial of each environment; None before the first reset."""
        return tuple(self._fleet.trials)

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ARG002
        """Stop the threads."""
        self._fleet.close()

    def _draw(self, i: int, given: Trial | str | None = None) -> Trial:
        return self._source.draw(self._randoms[i]) if given is None else self._source.find(given)

    def _picture(self, i: int) -> NDArray[np.uint8]:
        return self._fleet.view(i)

    def _begin(self, trials: list[tuple[int, Trial]], infos: dict[str, Any], *, render: bool = True) -> None:
        self._fleet.begin(trials)
        for i, trial in trials:
            self._begun[i] = True
            self._over[i] = False
            self._note(infos, i, trial=trial.id, town=trial.town)
        if render and self._camera is not None:
            self._camera.render([i for i, _ in trials])

    def _finish(self, ended: list[int], infos: dict[str, Any]) -> None:
        """Put the episodes that ended into ``infos``; with ``SameStep``, begin the next ones."""
        at_once = self.autoreset_mode is AutoresetMode.SAME_STEP
        pictures: list[Observation] = [{} for _ in ended]
        if at_once and self._camera is not None:
            pictures = self._camera.last(ended)
        for i, seen in zip(ended, pictures, strict=True):
            outcome = self._fleet.outcome_fields(i)
            ended_as = {"verdict": outcome["verdict"], "outcome": outcome} if outcome else {}
            last = {name: array[i].copy() for name, array in self._fleet.observation.items()} if at_once else {}
            self._note_end(infos, i, {**last, **seen}, **ended_as)
        if at_once:
            self._begin([(i, self._draw(i)) for i in ended], infos)

    def _observation(self) -> Observation:
        arrays = {**self._fleet.observation, **({} if self._camera is None else self._camera.pictures)}
        return {name: array.copy() for name, array in arrays.items()} if self.copy else arrays
