"""Many trials of a service as one environment: ``gymnasium.make_vec("wrongturn_client:Wrongturn-v0", num_envs=16)``."""

import contextlib
import time
import uuid
from collections.abc import Iterable, Sequence
from typing import Any, Final, Unpack, cast

import httpx
import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import concatenate, create_empty_array
from numpy.typing import NDArray

from wrongturn_client.episode_calls import OneThread, granted
from wrongturn_client.errors import ApiError, InvalidActionError, ServiceBusyError, ServiceFullError
from wrongturn_client.practice import Practice, PracticeEpisode, step_reply
from wrongturn_protocol import Track, TrialKeywords, TrialOptions
from wrongturn_protocol.environments import Flags, TrialVectorEnv
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.trial_options import check_keywords
from wrongturn_protocol.wire import Call

_BRIEFLY: Final = 5.0
"""Seconds to wait for more simulators while holding some; after 10 the service would release those."""
_STEP: Final = Call.STEP.value


class RemoteVectorEnv(TrialVectorEnv):
    """Practise many trials at once over one connection; each environment has its own generator and its own end.

    The steps of all environments go in one message. After ``reset(seed=s)``, environment ``i`` drives the same trials
    as a single environment after ``reset(seed=s + i)``. ``infos`` holds ``trial`` and ``town`` of each episode that
    began and ``verdict`` of each that ended, with masks under ``_trial`` and so on, as Gymnasium does. If the service
    gives an episode up, it is truncated with its last observation, and ``lost`` says why.

    Args:
        num_envs: Number of environments; the service needs as many simulators.
        autoreset_mode: When the next episode begins after an end. ``NextStep``: in the next step, whose action is
            ignored. ``SameStep``: at once; ``infos["final_obs"]`` and ``["final_info"]`` hold the end. ``Disabled``:
            when you call ``reset(options={"reset_mask": ...})``.
        render_mode: ``rgb_array``, to get pictures from ``render``. The service draws them.

    The other arguments are those of :class:`~wrongturn_client.RemoteEnv`.

    Raises:
        ValueError: A name does not exist, or options do not go together.
    """

    _NOT_BEGUN = ResetNeeded
    _ENDED = ResetNeeded
    _BAD_ACTION = InvalidActionError

    def __init__(
        self,
        num_envs: int = 1,
        url: str | None = None,
        token: str | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        patience: float = 60.0,
        render_mode: str | None = None,
        transport: httpx.BaseTransport | None = None,
        town: str | None = None,
        track: Track | str = Track.STATE,
        **options: Unpack[TrialKeywords],
    ) -> None:
        check_keywords(RemoteVectorEnv, options)
        trials = TrialOptions.of(town, track, **options)
        self._prepare(num_envs, trials.track, autoreset_mode, render_mode)
        self._alone = OneThread()
        self._practice = Practice(trials, url, token, patience, transport, self.num_envs)
        self._slots: int | None = None
        self._calls: dict[int, list[Any]] = {}
        """Calls that begin the next episodes, kept until they succeed: another attempt begins no other episode."""
        self._episodes = [PracticeEpisode() for _ in range(self.num_envs)]

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the next trials.

        Args:
            seed: Seed of the first generator (each next one is 1 higher), or one seed for each; None keeps generators.
            options: ``trial``: id of a trial of the suite for all environments, or one for each. ``reset_mask``: flags
                (n,) of the environments to reset.

        Raises:
            ValueError: The number of seeds, trials or flags is not that of the environments.
            ServiceFullError: The service has too few simulators, or too few free ones; nothing stays open then.
            WrongturnError: The service does not answer, or refuses.
        """
        with self._alone:
            asked = self._asked(seed, options, str)
            if not all(self._begun[i] or i in asked for i in range(self.num_envs)):
                raise ResetNeeded("options.reset_mask: environments that it leaves out have no trial; reset them too")
            for i, trial in asked.items():
                self._calls.pop(i, None)
                self._draw(i, trial)
            self._abort(asked)
            self.closed = False  # so that another close ends what begins now
            infos: dict[str, Any] = {}
            for i, reply in zip(asked, self._begin_all(list(asked)), strict=True):
                self._begin(i, reply, infos)
            return self._observation(), infos

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[Observation, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Drive on for 0.1 s. After an error you can repeat the step: each environment drives it only once.

        Args:
            actions: (n, 3): steer, throttle, brake.

        Raises:
            InvalidActionError: An action is out of range or not finite; nothing was driven.
            ResetNeeded: There is no episode to drive; call ``reset`` first.
            WrongturnError: The service does not answer, or refuses.
        """
        with self._alone:
            given, driven = self._driven(actions)
            rows = given.tolist()
            results = self._practice.exchange(
                [
                    [_STEP, episode.id, episode.seq + 1, *rows[i]] if driven[i] else self._draw(i)
                    for i, episode in enumerate(self._episodes)
                ]
            )
            replies = list(map(step_reply, results))
            # Nothing changes before all replies are here, so that a step that failed half-way can be repeated.
            ended = [i for i in np.flatnonzero(driven).tolist() if replies[i]["terminated"] or replies[i]["truncated"]]
            begun = {}
            if ended and self.autoreset_mode is AutoresetMode.SAME_STEP:
                following = self._practice.exchange([self._draw(i) for i in ended])
                begun = dict(zip(ended, map(granted, following), strict=True))
            return self._advance(replies, driven, begun)

    def close_extras(self, **kwargs: Any) -> None:  # noqa: ARG002
        """End open episodes and close the connection."""
        self._abort(range(self.num_envs))
        self._practice.close()

    def _picture(self, i: int) -> NDArray[np.uint8]:
        return self._practice.client.view(self._episodes[i].id or "")

    def _draw(self, i: int, trial: str | None = None) -> list[Any]:
        """Return the call that begins an environment's next episode."""
        if i not in self._calls:
            self._calls[i] = self._practice.call(self._randoms[i], trial)
        return self._calls[i]

    def _abort(self, chosen: Iterable[int]) -> None:
        episodes = [self._episodes[i] for i in chosen]
        self._practice.abort([episode.id for episode in episodes if episode.open])
        for i in chosen:
            self._episodes[i].open = self._begun[i] = False

    def _begin_all(self, chosen: list[int]) -> list[dict[str, Any]]:
        """Begin an episode in each of these environments, or raise an error and leave none open."""
        self._check_slots()
        end = time.monotonic() + self._practice.patience
        while True:
            results = self._practice.exchange(
                [self._calls[i] for i in chosen], None if self.num_envs == 1 else _BRIEFLY
            )
            refused = [result for result in results if isinstance(result, ApiError)]
            if not refused:
                return [granted(result) for result in results]
            # While waiting for more simulators, hold none that others wait for.
            begun = {i: result["id"] for i, result in zip(chosen, results, strict=True) if isinstance(result, dict)}
            self._practice.abort(list(begun.values()))
            for refusal in refused:
                if not isinstance(refusal, ServiceBusyError):
                    raise refusal
            first, left = refused[0], end - time.monotonic()
            if left <= 0 and not begun:
                raise first
            if left <= 0:
                raise ServiceFullError(
                    f"num_envs: is {self.num_envs}, and {len(begun)} of {len(chosen)} episodes could begin "
                    f"({first}); make fewer environments, or try again when the service is less busy"
                ) from first
            for i in begun:
                self._calls[i] = [*self._calls[i][:2], str(uuid.uuid4())]  # another episode of the same trial
            time.sleep(min(left, 1.0 if first.retry_after is None else first.retry_after))

    def _check_slots(self) -> None:
        if self.num_envs > 1 and self._slots is None:
            with contextlib.suppress(ApiError):
                self._slots = self._practice.client.simulators()
        if self._slots is not None and self._slots < self.num_envs:
            slots, self._slots = self._slots, None  # the service may be restarted with more
            raise ServiceFullError(
                f"num_envs: is {self.num_envs}, and the service at {self._practice.client.url} has {slots} simulators; "
                f"make {slots} environments at most, or start it with WRONGTURN_SIMULATORS={self.num_envs} or more"
            )

    def _begin(self, i: int, reply: dict[str, Any], infos: dict[str, Any]) -> None:
        self._calls.pop(i, None)
        self._begun[i], self._over[i] = True, False
        self._note(infos, i, **self._episodes[i].begin(reply))

    def _advance(
        self, replies: list[dict[str, Any]], driven: Flags, begun: dict[int, dict[str, Any]]
    ) -> tuple[Observation, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Take the replies of all environments, and of those that began at once after an end."""
        rewards = np.zeros(self.num_envs)
        terminated, truncated = np.zeros((2, self.num_envs), np.bool_)
        infos: dict[str, Any] = {}
        for i, (episode, reply) in enumerate(zip(self._episodes, replies, strict=True)):
            if not driven[i]:
                self._begin(i, reply, infos)
                continue
            rewards[i], terminated[i], truncated[i], info = episode.advance(reply)
            self._over[i] = not episode.open
            if self._over[i]:
                self._note_end(infos, i, episode.seen, **info)
            if i in begun:
                self._begin(i, begun[i], infos)
        return self._observation(), rewards, terminated, truncated, infos

    def _observation(self) -> Observation:
        space = self.single_observation_space
        batch = cast(Observation, create_empty_array(space, self.num_envs))
        return cast(Observation, concatenate(space, [episode.seen for episode in self._episodes], batch))
