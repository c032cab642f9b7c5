"""Many egos of one town in one process, as one Gymnasium environment.

``gymnasium.make_vec("wrongturn_sim:WrongturnSim-v0", num_envs=64, town="Town01", track="camera", threads=2)``

It needs neither SUMO nor further processes. Its egos drive alone, and each drives, sees and is judged byte for byte as
in :class:`~wrongturn_sim.gym_env.WrongturnSimEnv`.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from wrongturn_networks import load_town
from wrongturn_protocol import Track, Traffic, Trial, TrialKeywords, TrialOptions
from wrongturn_protocol.observations import IMAGE_SHAPE, Observation, action_space, observation_space
from wrongturn_protocol.vectors import Flags, checked_actions, mask_of, seeds_of, trials_of, whole_number
from wrongturn_sim.errors import EpisodeAlreadyFinishedError, EpisodeNotStartedError, InvalidActionError
from wrongturn_sim.fleet.fleet import Fleet, Record
from wrongturn_sim.trial_source import TrialSource, a_flag

if TYPE_CHECKING:
    from wrongturn_sim.camera import Camera
    from wrongturn_sim.fleet.camera import FleetCamera


class WrongturnVectorEnv(VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Drive many trials at once, each with its own generator and its own end.

    Environment ``i`` of ``reset(seed=s)`` draws and drives what a single environment does after ``reset(seed=s + i)``.
    ``infos`` holds ``trial`` and ``town`` where one began, ``verdict`` and ``outcome`` where one ended, in Gymnasium's
    form: with a mask under ``_trial`` and so on.

    Args:
        num_envs: how many.
        town: The town to draw trials in.
        track: What the agent is shown.
        camera: its place and optics, in the tracks that have one; the benchmark's own by default.
        threads: how many share the work of a step; no byte hangs on it.
        backend: where pictures are made: ``cpu``; or ``cuda``, an NVIDIA GPU. They stay there then:
            ``torch.as_tensor(observation["rgb"], device="cuda")`` shares their memory, and pictures in ``final_obs``
            last until that environment ends again.
        strict: a journey ends where the car leaves its road or lane, or stands; for training.
        record: keep trajectories and actions for :meth:`episode`; training needs none, and they take room.
        autoreset_mode: when an environment that ended begins anew: ``NextStep`` (then the action of that step is not
            looked at), ``SameStep`` (then ``infos["final_obs"]`` and ``["final_info"]`` hold the end), or ``Disabled``
            (by ``reset(options={"reset_mask": ...})``).
        copy: give fresh arrays; else those that the next step writes over.
        render_mode: None; the pictures are observations.
        options: ``approach``, ``fault``, ``task``, ``suite`` and so on; see :class:`~wrongturn_protocol.TrialOptions`.
            ``traffic`` is not possible, and a ``suite`` has to be of one town.

    Raises:
        ValueError: A name does not exist, or options do not go together.
    """

    metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        town: str | None = None,
        track: Track | str = Track.STATE,
        *,
        camera: "Camera | None" = None,
        threads: int = 1,
        backend: str = "cpu",
        strict: bool = False,
        record: bool = True,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Unpack[TrialKeywords],
    ) -> None:
        for name, number in (("num_envs", num_envs), ("threads", threads)):
            whole_number(name, number)
        for name, flag in (("strict", strict), ("record", record)):
            a_flag(name, flag)
        if backend not in ("cpu", "cuda"):
            raise ValueError(f"backend: is {backend!r}; give cpu or cuda")
        if render_mode is not None:
            raise ValueError(f"render_mode: {render_mode!r} is not there; leave it None, pictures are observations")
        trials = TrialOptions.of(town, track, **options)
        if trials.traffic != Traffic():
            raise ValueError("traffic: egos of one batch drive alone; leave it out, or take single environments")
        self.track = trials.track
        self._source = TrialSource(trials)
        if len(self._source.towns) != 1:
            raise ValueError(f"suite: {trials.suite} is of {', '.join(self._source.towns)}; the egos share one town")
        self.num_envs = num_envs
        self.copy = copy
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = None
        self._fleet = Fleet(
            load_town(self._source.towns[0]), num_envs, self.track, threads=threads, strict=strict, record=record
        )
        has_pictures = self.track in {Track.CAMERA, Track.SEGMENTATION}
        self._camera = self._camera_of(camera, threads, backend) if has_pictures else None
        size = IMAGE_SHAPE if camera is None else (camera.height, camera.width)
        space = observation_space(self.track, size)
        self.single_observation_space = space
        self.single_action_space = action_space()
        self.observation_space = batch_space(space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._randoms: list[np.random.Generator | None] = [None] * num_envs
        self._begun = np.zeros(num_envs, np.bool_)
        self._over = np.zeros(num_envs, np.bool_)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the next trials.

        Args:
            seed: of the generators: of the first, the next ones' are 1 higher each; or one for each; None goes on.
            options: ``trial``: drive this one (a Trial, or an id of the suite), or one for each; ``reset_mask``, (n,)
                of bool: begin these only.

        Raises:
            ValueError: another number of seeds, trials or flags than of environments.
            SimError: as :class:`~wrongturn_sim.fleet.fleet.Fleet`.
        """
        seeds = seeds_of(seed, self.num_envs)
        trials: list[Trial | str | None] = trials_of(options, self.num_envs, (str, Trial))
        chosen = mask_of(options, self.num_envs)
        for i in chosen:
            if seeds[i] is not None or self._randoms[i] is None:
                self._randoms[i], _ = seeding.np_random(seeds[i])
        infos: dict[str, Any] = {}
        self._begin([(i, self._draw(i, trials[i])) for i in chosen], infos)
        return self._observation(), infos

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observation, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Drive on for 0.1 s.

        Args:
            actions: (n, 3): steer, throttle, brake.

        Raises:
            InvalidActionError: a field is no number, not finite or out of its range; nothing was driven.
            EpisodeNotStartedError: call ``reset`` first.
            EpisodeAlreadyFinishedError: one ended, and does not begin anew of itself.
        """
        if not self._begun.all():
            raise EpisodeNotStartedError("step before the first reset; call reset")
        waiting = self._over if self.autoreset_mode is AutoresetMode.NEXT_STEP else np.zeros_like(self._over)
        driven = ~waiting
        if (self._over & driven).any():
            raise EpisodeAlreadyFinishedError(
                f"environments {np.flatnonzero(self._over).tolist()} ended; reset them with options reset_mask",
            )
        fleet = self._fleet
        fleet.step(checked_actions(actions, driven, InvalidActionError).astype(np.float32), driven)
        infos: dict[str, Any] = {}
        if waiting.any():
            self._begin([(i, self._draw(i)) for i in np.flatnonzero(waiting).tolist()], infos, render=False)
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
        """The trajectory of an environment's episode, as far as it went, and what it came to.

        Where it ended it is kept until the next one begins: with ``SameStep`` that is at once.

        Raises:
            ValueError: nothing was begun, or no record is kept.
        """
        return self._fleet.record(index)

    @property
    def steps(self) -> NDArray[np.int64]:
        """(n,): decisions of each environment's episode so far."""
        return self._fleet.steps

    @property
    def trials(self) -> tuple[Trial | None, ...]:
        """What each environment drives."""
        return tuple(self._fleet.trials)

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ARG002
        """End the threads."""
        self._fleet.close()

    def _camera_of(self, camera: "Camera | None", threads: int, backend: str) -> "FleetCamera":
        from wrongturn_sim.camera import Camera  # noqa: PLC0415 - who shows no pictures need not wait for it
        from wrongturn_sim.fleet.camera import FleetCamera  # noqa: PLC0415

        return FleetCamera(self._fleet, camera or Camera(), self.track, threads, backend)

    def _draw(self, i: int, given: Trial | str | None = None) -> Trial:
        random = self._randoms[i]
        assert random is not None
        return self._source.draw(random) if given is None else self._source.find(given)

    def _begin(self, trials: list[tuple[int, Trial]], infos: dict[str, Any], *, render: bool = True) -> None:
        self._fleet.begin(trials)
        for i, trial in trials:
            self._begun[i] = True
            self._over[i] = False
            self._note(infos, i, trial=trial.id, town=trial.town)
        if render and self._camera is not None:
            self._camera.render([i for i, _ in trials])

    def _finish(self, ended: list[int], infos: dict[str, Any]) -> None:
        """Tell of the episodes that ended, and begin the next ones where that is to be at once."""
        at_once = self.autoreset_mode is AutoresetMode.SAME_STEP
        pictures: list[Observation] = [{} for _ in ended]
        if at_once and self._camera is not None:
            pictures = self._camera.last(ended)
        for i, seen in zip(ended, pictures, strict=True):
            outcome = self._fleet.outcome_fields(i)
            ended_as = {"verdict": outcome["verdict"], "outcome": outcome}
            if at_once:
                last = {**{name: array[i].copy() for name, array in self._fleet.observation.items()}, **seen}
                self._note(infos, i, final_obs=last)
                self._note(infos.setdefault("final_info", {}), i, **ended_as)
                infos["_final_info"] = infos["_final_obs"]
            else:
                self._note(infos, i, **ended_as)
        if at_once:
            self._begin([(i, self._draw(i)) for i in ended], infos)

    def _note(self, infos: dict[str, Any], i: int, **values: Any) -> None:
        """As ``_add_info``, but each value stays what it is: that one would spread a dict over arrays of numbers."""
        for name, value in values.items():
            if name not in infos:
                infos[name] = np.full(self.num_envs, None, object)
                infos[f"_{name}"] = np.zeros(self.num_envs, np.bool_)
            infos[name][i] = value
            infos[f"_{name}"][i] = True

    def _arrays(self) -> Observation:
        arrays = self._fleet.observation
        return arrays if self._camera is None else {**arrays, **self._camera.pictures}

    def _observation(self) -> Observation:
        arrays = self._arrays()
        return {name: array.copy() for name, array in arrays.items()} if self.copy else dict(arrays)
