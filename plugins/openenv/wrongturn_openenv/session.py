"""One client's environment: the Gymnasium environment over the wire, in OpenEnv's words."""

import contextlib
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import httpx

from wrongturn_client import Client, WrongturnError
from wrongturn_client.closing import Closing
from wrongturn_client.errors import AuthenticationError
from wrongturn_client.gym_env import RemoteEnv
from wrongturn_client.practice import practice_token
from wrongturn_openenv.messages import ErrorCode, RefusedError, Reply, ResetRequest, State, refusals
from wrongturn_protocol import Action, Track, TrialOptions
from wrongturn_protocol.observations import encode

PATIENCE_S: Final = 45.0
"""Seconds to wait for a busy service. OpenEnv's client waits 60 s for an answer, so it hears why there is none."""


@dataclass
class Service:
    """The service that the sessions practise on, with an agent for practice in each track that was asked for."""

    url: str
    token: str | None = None
    """An agent's token; its track is then the only one. Without it, agents for practice are registered."""
    defaults: Mapping[str, Any] = field(default_factory=dict)
    """Options of trials where a reset names none; see :class:`~wrongturn_protocol.TrialOptions`."""
    transport: httpx.BaseTransport | None = None
    """An httpx transport, for tests."""
    _tokens: dict[Track, str] = field(default_factory=dict)
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def environment(self, options: Mapping[str, Any]) -> tuple[RemoteEnv, str]:
        """Return an environment that draws its trials by these options, and the token that it uses."""
        track = TrialOptions.of(**options).track
        token = self.token or self._registered(track)
        return RemoteEnv(self.url, token, patience=PATIENCE_S, transport=self.transport, **options), token

    def forget(self, track: Track, token: str) -> bool:
        """Forget an agent that the service does not know any more, so that the next environment registers another.

        Returns:
            Whether another can be registered: False if the token was given from outside.
        """
        with self._lock:
            if self._tokens.get(track) == token:  # else another session has registered one already
                del self._tokens[track]
        return self.token is None

    def check(self) -> None:
        """Raise WrongturnError unless the service answers and has the town or suite of the defaults."""
        with self._client(patience=0) as client:
            client.live()
            if (town := self.defaults.get("town")) is not None:
                client.town(town)
            if (suite := self.defaults.get("suite")) is not None:
                client.suite(suite)

    def ready(self) -> bool:
        """Tell whether the service can take episodes."""
        with contextlib.suppress(WrongturnError), self._client(patience=0) as client:
            return client.ready()
        return False

    def _registered(self, track: Track) -> str:
        with self._lock:
            if track not in self._tokens:
                with self._client(PATIENCE_S) as client:
                    self._tokens[track] = practice_token(client, track)
            return self._tokens[track]

    def _client(self, patience: float) -> Client:
        return Client(self.url, self.token or "", transport=self.transport, patience=patience)


class Session(Closing):
    """The episodes of one client, one after the other. A thread waits until another one's call is done."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._env: RemoteEnv | None = None
        self._token = ""
        self._lock = threading.RLock()
        self._options: dict[str, Any] = {}
        self.state = State()
        """What the client can ask about its episode, beside the observation."""

    def reset(self, asked: ResetRequest) -> Reply:
        """Begin the next episode. An episode that is open is ended.

        Args:
            asked: Its parameters. One that is None drops the server's own option.

        Raises:
            RefusedError: A parameter is wrong, or the service cannot begin the episode.
        """
        given = {name: getattr(asked, name) for name in asked.model_fields_set - {"seed", "episode_id", "trial"}}
        options = {name: value for name, value in {**self._service.defaults, **given}.items() if value is not None}
        with self._lock, refusals():
            try:
                return self._begin(asked, options)
            except AuthenticationError:  # its token was revoked, or the service has another database
                if self._env is None or not self._service.forget(self._env.track, self._token):
                    raise
                self.close()
                return self._begin(asked, options)

    def _begin(self, asked: ResetRequest, options: dict[str, Any]) -> Reply:
        if self._env is None or options != self._options:
            env, token = self._service.environment(options)
            self.close()
            self._env, self._token, self._options, self.state = env, token, options, State()
        env = self._env
        chosen = None if asked.trial is None else {"trial": asked.trial}
        observation, info = env.reset(seed=asked.seed, options=chosen)
        name = asked.episode_id or env.episode
        self.state = State(episode_id=name, track=env.track, town=info["town"], trial=info["trial"])
        return Reply(observation=encode(observation, env.track))

    def step(self, action: Action) -> Reply:
        """Drive on for 0.1 s.

        Raises:
            RefusedError: No episode is open. Or the service does not answer; you can then repeat the step, which is
                driven only once.
        """
        if self._env is None:
            raise RefusedError(ErrorCode.EXECUTION_ERROR, "step before the first reset; call reset")
        with self._lock, refusals():
            observation, reward, terminated, truncated, info = self._env.step(action)
            self.state = self.state.model_copy(
                update={
                    "step_count": self.state.step_count + ("lost" not in info),
                    "terminated": terminated,
                    "truncated": truncated,
                    "verdict": info.get("verdict"),
                    "lost": info.get("lost"),
                }
            )
            return Reply(
                observation=encode(observation, self._env.track), reward=float(reward), done=terminated or truncated
            )

    def close(self) -> None:
        """End an open episode and close the connection."""
        with self._lock:
            if self._env is not None:
                self._env.close()
            self._env = None
