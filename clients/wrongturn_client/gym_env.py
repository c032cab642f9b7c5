"""The Gymnasium environment over the wire: ``gymnasium.make("wrongturn_client:Wrongturn-v0", url=...)``."""

from typing import Any, SupportsFloat, Unpack

import httpx
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray

from wrongturn_client.episode_calls import OneThread, granted, step_call
from wrongturn_client.practice import Practice, PracticeEpisode, step_reply
from wrongturn_protocol import ActionLike, Track, TrialKeywords, TrialOptions
from wrongturn_protocol.environments import TrialEnv
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.trial_options import check_keywords, check_options


class RemoteEnv(TrialEnv):
    """Practise on a service; nothing is scored.

    Each reset draws a new trial from the environment's own generator, which ``reset(seed=...)`` sets, unless ``suite``
    and ``trial`` name one. ``info`` holds ``trial`` and ``town``, and at the end ``verdict``. If the service gives an
    episode up, because it was restarted or heard nothing for too long, the episode is truncated with its last
    observation, and ``info["lost"]`` says why.

    Args:
        url: The service's URL; ``WRONGTURN_URL`` by default.
        token: An agent's token; ``WRONGTURN_TOKEN`` by default. Without one, an agent for practice is registered.
        patience: Seconds for which calls are repeated while the service is busy or does not answer.
        render_mode: ``rgb_array``, to get pictures from ``render``; ``human``, to watch them in a window, which needs
            pygame (the extra ``wrongturn-client[human]``). The service draws them.
        transport: An httpx transport, for tests.
        town: The town to draw trials in; ``Town01`` by default.
        track: What the agent is shown.
        options: ``fault``, ``task``, ``suite`` and so on; see :class:`~wrongturn_protocol.TrialOptions`.

    Raises:
        ValueError: A name does not exist, or options do not go together.
    """

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        patience: float = 60.0,
        render_mode: str | None = None,
        transport: httpx.BaseTransport | None = None,
        town: str | None = None,
        track: Track | str = Track.STATE,
        **options: Unpack[TrialKeywords],
    ) -> None:
        check_keywords(RemoteEnv, options)
        trials = TrialOptions.of(town, track, **options)
        self._prepare(trials.track, render_mode)
        self._alone = OneThread()
        self._practice = Practice(trials, url, token, patience, transport)
        self._episode = PracticeEpisode()

    @property
    def episode(self) -> str | None:
        """The service's id of the episode that is open or was the last; None before the first reset."""
        return self._episode.id

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the next trial, or the trial of the suite that ``options["trial"]`` names.

        Raises:
            WrongturnError: The service does not answer, or refuses.
        """
        with self._alone:
            super().reset(seed=seed)
            call = self._practice.call(self.np_random, check_options(options, ("trial",)).get("trial"))
            self._abort()
            (result,) = self._practice.exchange([call])
            info = self._episode.begin(granted(result))
            self._watch()
            return self._episode.seen, info

    def step(self, action: ActionLike) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Drive on for 0.1 s. After an error you can repeat the step: it is driven only once.

        The action is steer, throttle and brake: a float32 array (3,), a tuple, a list or an Action.

        Raises:
            InvalidActionError: It is not three numbers, or one is out of range.
            ResetNeeded: No episode is open.
            WrongturnError: The service does not answer, or refuses.
        """
        with self._alone:
            episode = self._episode
            if episode.id is None or not episode.open:
                raise ResetNeeded(
                    f"step {'before the first reset' if episode.id is None else 'after the end'}; call reset"
                )
            (result,) = self._practice.exchange([step_call(episode.id, episode.seq + 1, action)])
            reward, terminated, truncated, info = episode.advance(step_reply(result))
            if "lost" not in info:
                self._watch()
            return episode.seen, reward, terminated, truncated, info

    def close(self) -> None:
        """End an open episode, and close the connection and the window."""
        super().close()
        self._abort()
        self._practice.close()
        self._episode = PracticeEpisode()

    def _picture(self) -> NDArray[np.uint8]:
        if self._episode.id is None:
            raise ResetNeeded("render before the first reset; call reset")
        return self._practice.client.view(self._episode.id)

    def _abort(self) -> None:
        if self._episode.open:
            self._practice.abort([self._episode.id])
        self._episode.open = False
