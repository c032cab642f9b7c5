"""The Gymnasium environment over the wire: ``gymnasium.make("wrongturn_client:Wrongturn-v0", url=...)``."""

from typing import Any, SupportsFloat, Unpack

import gymnasium
import httpx
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray
from pydantic import ValidationError

from wrongturn_client.actions import action_error
from wrongturn_client.episode_calls import granted, step_call
from wrongturn_client.errors import EpisodeFinishedError, EpisodeLostError, InvalidActionError
from wrongturn_client.practice import Practice
from wrongturn_protocol import Action, Track, TrialKeywords, TrialOptions
from wrongturn_protocol.observations import Observation, action_space, observation_space


class RemoteEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Practise against a service; nothing here is ever scored.

    Each reset draws a new trial from the environment's own generator (``reset(seed=...)`` sets it), unless ``suite``
    and ``trial`` name one. ``info`` names the trial and its town, and at the end holds ``verdict``. An episode that
    the service gave up, since it was started again or heard nothing for too long, is truncated with its last
    observation, and ``info["lost"]`` says why.

    Args:
        url: of the service; ``WRONGTURN_URL`` by default.
        token: an agent's; ``WRONGTURN_TOKEN`` by default. Where there is none, an agent for practice is registered.
        patience: seconds for which is tried again while the service is busy or gone.
        render_mode: None; the pictures are observations.
        transport: of httpx, for tests.
        town: The town to draw trials in; ``Town01`` by default.
        track: What the agent is shown.
        options: ``fault``, ``task``, ``suite`` and so on; see :class:`~wrongturn_protocol.TrialOptions`.

    Raises:
        ValueError: names that do not exist, or do not go together.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

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
        if render_mode is not None:
            raise ValueError(f"render_mode: {render_mode!r} is not there; leave it None, pictures are observations")
        self.render_mode = None
        trials = TrialOptions.of(town, track, **options)
        self.track = trials.track
        self.observation_space = observation_space(self.track)  # type: ignore[assignment]
        self.action_space = action_space()  # type: ignore[assignment]
        self._practice = Practice(trials, url, token, patience, transport)
        self._episode: str | None = None
        self._ended = True
        self._seq = 0
        self._seen: Observation = {}

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin a trial: the next, or the one of the suite that ``options["trial"]`` names.

        Raises:
            WrongturnError: the service cannot be reached, or refuses.
        """
        super().reset(seed=seed)
        call = self._practice.call(self.np_random, (options or {}).get("trial"))
        self._abort()
        (result,) = self._practice.exchange([call])
        reply = granted(result)
        self._episode, self._seq, self._ended, self._seen = reply["id"], 0, False, reply["observation"]
        return reply["observation"], {"trial": reply["trial"], "town": reply["town"]}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Drive on for 0.1 s. Where this raises, the same step may be taken again: it is driven once.

        Args:
            action: float32 (3,): steer, throttle, brake.

        Raises:
            InvalidActionError: it is none, or out of range.
            ResetNeeded: no episode was begun, or it ended.
            WrongturnError: the service cannot be reached, or refuses.
        """
        if self._episode is None or self._ended:
            raise ResetNeeded(
                f"step {'before the first reset' if self._episode is None else 'after the end'}; call reset"
            )
        (result,) = self._practice.exchange([step_call(self._episode, self._seq + 1, _action(action))])
        if isinstance(result, EpisodeLostError | EpisodeFinishedError):
            self._ended = True
            return self._seen, 0.0, False, True, {"lost": str(result)}
        reply = granted(result)
        self._seq, self._seen = reply["seq"], reply["observation"]
        terminated, truncated = reply["terminated"], reply["truncated"]
        self._ended = terminated or truncated
        verdict = reply.get("verdict")
        info: dict[str, Any] = {} if verdict is None else {"verdict": str(verdict)}
        return reply["observation"], reply.get("reward") or 0.0, terminated, truncated, info

    def close(self) -> None:
        """Give an open episode up and close the connection."""
        self._abort()
        self._practice.close()
        self._episode = None

    def _abort(self) -> None:
        if self._episode is not None and not self._ended:
            self._practice.abort([self._episode])
        self._ended = True


def _action(action: object) -> Action:
    try:
        steer, throttle, brake = np.asarray(action, np.float64).tolist()
    except (TypeError, ValueError):
        raise InvalidActionError(f"action: {action!r} is not three numbers; give steer, throttle, brake") from None
    try:
        return Action(steer=steer, throttle=throttle, brake=brake)
    except ValidationError as error:
        raise InvalidActionError(action_error(error)) from None
