"""The Gymnasium environment over the wire: ``gymnasium.make("wrongturn_client:Wrongturn-v0", url=...)``."""

import contextlib
import secrets
from collections.abc import Mapping
from typing import Any, Final, SupportsFloat

import gymnasium
import httpx
import numpy as np
from gymnasium.error import ResetNeeded
from numpy.typing import NDArray
from pydantic import ValidationError

from wrongturn_client import settings
from wrongturn_client.actions import told
from wrongturn_client.client import Client
from wrongturn_client.errors import InvalidActionError, WrongturnError
from wrongturn_protocol import Action, Command, Fault, FaultKind, PracticeRequest, Task, Track, Traffic, Weather
from wrongturn_protocol.observations import Observation, action_space, observation_space

_SEEDS: Final = 2**31
_DEFAULT_TOWN: Final = "Town01"


class WrongturnEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Practise against a service; nothing here is ever scored.

    Each reset draws a new trial from the environment's own generator (``reset(seed=...)`` sets it), unless ``suite``
    and ``trial`` name one. ``info`` names the trial and its town, and at the end holds ``verdict``.

    Args:
        url: of the service; ``WRONGTURN_URL`` by default.
        token: an agent's; ``WRONGTURN_TOKEN`` by default. Where there is none, an agent for practice is registered.
        track: what is shown.
        town: where trials are drawn, ``Town01`` by default.
        approach: the arm that all drawn trials drive in by, such as ``J3-S``; any that admits the fault by default.
        fault: of the drawn trials.
        task: draw journeys of this task, such as ``navigation``, which go on over any number of junctions.
        route: the direction of the drawn trials' route; by the seed by default.
        weather: of the drawn trials.
        traffic: of the drawn trials, as ``{"vehicles": 20, "pedestrians": 10}``.
        suite: draw among this suite's open trials and their twins instead.
        trial: this trial of the suite each time.
        render_mode: None; the pictures are observations.
        transport: of httpx, for tests.

    Raises:
        ValueError: names that do not exist, or do not go together.
    """

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(
        self,
        url: str | None = None,
        token: str | None = None,
        *,
        track: Track | str = Track.STATE,
        town: str | None = None,
        approach: str | None = None,
        fault: Fault | FaultKind | str = FaultKind.NONE,
        task: Task | str | None = None,
        route: Command | int | None = None,
        weather: Weather | str = Weather.CLEAR_NOON,
        traffic: Traffic | Mapping[str, int] = Traffic(),  # noqa: B008 - immutable
        suite: str | None = None,
        trial: str | None = None,
        render_mode: str | None = None,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self.track = Track(track)
        if render_mode is not None:
            raise ValueError(f"render_mode: {render_mode!r} is not there; leave it None, pictures are observations")
        if suite is not None and (town is not None or approach is not None):
            raise ValueError("suite: its trials name their towns; leave town and approach out")
        if suite is not None and task is not None:
            raise ValueError("suite: its trials have their own tasks; leave task out")
        if trial is not None and suite is None:
            raise ValueError(f"trial: {trial!r} needs the suite that it stands in; give suite too")
        self.render_mode = None
        self.observation_space = observation_space(self.track)  # type: ignore[assignment]
        self.action_space = action_space()  # type: ignore[assignment]
        self._url = url
        self._token = token or settings.token()
        self._transport = transport
        self._client: Client | None = None
        self._town = town or _DEFAULT_TOWN
        self._fault = fault if isinstance(fault, Fault) else Fault(kind=FaultKind(fault))
        self._task = None if task is None else Task(task)
        self._route = None if route is None else Command(route)
        self._weather = Weather(weather)
        self._traffic = Traffic.model_validate(traffic)
        self._suite = suite
        self._approaches: tuple[str, ...] = () if approach is None else (approach,)
        self._trials: tuple[str, ...] = () if trial is None else (trial,)
        self._episode: str | None = None
        self._ended = True
        self._seq = 0

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
        client = self._connect()
        self._abort()
        reply = client.practise(self._request(client, (options or {}).get("trial")))
        self._episode, self._seq, self._ended = reply.id, 0, False
        return reply.observation, {"trial": reply.trial, "town": reply.town}

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Drive on for 0.1 s.

        Args:
            action: float32 (3,): steer, throttle, brake.

        Raises:
            InvalidActionError: it is none, or out of range.
            ResetNeeded: no episode was begun.
            WrongturnError: the service cannot be reached, or refuses.
        """
        if self._episode is None or self._client is None:
            raise ResetNeeded("step before the first reset; call reset")
        reply = self._client.step(self._episode, self._seq + 1, _action(action))
        self._seq = reply.seq
        self._ended = reply.terminated or reply.truncated
        info: dict[str, Any] = {} if reply.verdict is None else {"verdict": str(reply.verdict)}
        return reply.observation, reply.reward or 0.0, reply.terminated, reply.truncated, info

    def close(self) -> None:
        """Give an open episode up and close the connection."""
        self._abort()
        if self._client is not None:
            self._client.close()
        self._client = None
        self._episode = None

    def _connect(self) -> Client:
        if self._client is None:
            if self._token is None:
                with Client(self._url, transport=self._transport) as client:
                    name = f"practice-{secrets.token_hex(6)}"
                    self._token = client.register(name, self.track, description="Registered for practice.").token
            self._client = Client(self._url, self._token, transport=self._transport)
        return self._client

    def _abort(self) -> None:
        """An episode that nobody drives on would hold its simulator until the service gives it up."""
        if self._client is not None and self._episode is not None and not self._ended:
            with contextlib.suppress(WrongturnError):
                self._client.abort_episode(self._episode)
        self._ended = True

    def _request(self, client: Client, trial: str | None) -> PracticeRequest:
        if self._suite is not None:
            if trial is None and not self._trials:
                trials = client.trials(self._suite)
                self._trials = tuple(name for one in trials for name in (one.id, one.twin) if name)
            chosen = trial or self._trials[int(self.np_random.integers(len(self._trials)))]
            return PracticeRequest(suite=self._suite, trial=chosen, track=self.track)
        if trial is not None:
            raise ValueError(f"options: the trial {trial!r} needs an environment that was made with its suite")
        if not self._approaches and self._task is None:
            self._approaches = tuple(sorted(one.id for one in client.town(self._town).approaches if self._admits(one)))
            if not self._approaches:
                raise ValueError(f"fault: {self._fault.kind} suits no such approach of {self._town}; take another")
        # A journey may begin anywhere.
        number = len(self._approaches)
        approach = self._approaches[int(self.np_random.integers(number))] if number else None
        return PracticeRequest.model_validate(
            {
                "town": self._town,
                "approach": approach,
                "task": self._task,
                "route": self._route,
                "fault": self._fault,
                "weather": self._weather,
                "traffic": self._traffic,
                "seed": int(self.np_random.integers(_SEEDS)),
                "track": self.track,
            },
        )

    def _admits(self, approach: Any) -> bool:
        if self._route is not None and self._route not in approach.exits:
            return False
        return self._fault.kind is not FaultKind.INFEASIBLE or approach.type.missing is not None


def _action(action: object) -> Action:
    try:
        steer, throttle, brake = np.asarray(action, np.float64).tolist()
    except (TypeError, ValueError):
        raise InvalidActionError(f"action: {action!r} is not three numbers; give steer, throttle, brake") from None
    try:
        return Action(steer=steer, throttle=throttle, brake=brake)
    except ValidationError as error:
        raise InvalidActionError(told(error)) from None
