"""What the environments over the wire share: an agent for practice, trials to draw, episodes and a connection."""

import contextlib
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import httpx
import numpy as np

from wrongturn_client import settings
from wrongturn_client.client import Client
from wrongturn_client.closing import Closing
from wrongturn_client.episode_calls import DriveConnection, EpisodeCall, Result, granted, practise_call, shown_track
from wrongturn_client.errors import EpisodeFinishedError, EpisodeLostError, WrongturnError
from wrongturn_protocol import ApproachDetail, OptionError, PracticeRequest, Rig, Track, Trial, TrialOptions
from wrongturn_protocol.observations import Observation
from wrongturn_protocol.trial_options import DEFAULT_TOWN
from wrongturn_protocol.wire import CALLS, Call

_THREADS: Final = 16
"""Calls over HTTP at a time."""
_GOODBYE: Final = 2.0
"""Seconds for which to try to end episodes when the service does not answer."""


@dataclass
class PracticeEpisode:
    """An environment's episode, or none before the first reset."""

    id: str | None = None
    open: bool = False
    seq: int = 0
    seen: Observation = field(default_factory=dict)
    """The last observation."""

    def begin(self, reply: dict[str, Any]) -> dict[str, Any]:
        """Take the reply to a reset, and return Gymnasium's ``info``."""
        self.id, self.open, self.seq, self.seen = reply["id"], True, 0, reply["observation"]
        if shown_track(self.seen) is None:
            raise OptionError("token: its agent has a rig, and these environments show tracks; give another's, or none")
        return {"trial": reply["trial"], "town": reply["town"]}

    def advance(self, reply: dict[str, Any]) -> tuple[float, bool, bool, dict[str, Any]]:
        """Take the reply to a step; return reward, whether it terminated, whether it was truncated, and ``info``."""
        self.seq += 1
        self.seen = reply.get("observation", self.seen)
        terminated, truncated = reply["terminated"], reply["truncated"]
        self.open = not (terminated or truncated)
        info = {name: str(reply[name]) for name in ("verdict", "lost") if reply.get(name) is not None}
        return reply.get("reward") or 0.0, terminated, truncated, info


def step_reply(result: Result) -> dict[str, Any]:
    """Return the reply to a step, also for an episode that the service gave up; raise any other ApiError."""
    if isinstance(result, EpisodeLostError | EpisodeFinishedError):
        return {"lost": str(result), "terminated": False, "truncated": True}
    return granted(result)


class Practice(Closing):
    """Practice of one agent with the arguments of an environment; raises ValueError for a wrong one.

    It connects on first use, so you can make it in one process and use it in another.
    """

    def __init__(
        self,
        options: TrialOptions,
        url: str | None,
        token: str | None,
        patience: float = 60.0,
        transport: httpx.BaseTransport | None = None,
        parallel: int = 1,
    ) -> None:
        if isinstance(patience, bool) or not isinstance(patience, int | float) or not patience >= 0:
            raise ValueError(f"patience: is {patience!r}; give seconds, 0 or more")
        if options.journeys is not None:
            raise OptionError("journeys: the service draws cruises its own way; leave it out, or drive in process")
        if isinstance(options.trial, Trial):
            raise OptionError(f"trial: a service takes no Trial; give suite and trial={options.trial.id!r}")
        self.patience = patience
        self._options = options
        self._approaches: tuple[str, ...] = () if options.approach is None else (options.approach,)
        self._trials: tuple[str, ...] = () if options.trial is None else (options.trial,)
        self._url = url
        self._token = token or settings.token()
        self._transport = transport
        self._parallel = min(parallel, _THREADS)
        self._client: Client | None = None
        self._connection: DriveConnection | None = None

    @property
    def client(self) -> Client:
        """A client with the agent's token."""
        if self._client is None:
            if self._token is None:
                with self._make() as client:
                    self._token = practice_token(client, self._options.track)
            self._client = self._make()
        return self._client

    def call(self, random: np.random.Generator, trial: str | None = None) -> list[Any]:
        """Draw a trial, or take the suite's named one, and return the call that begins it.

        Equal generators give equal trials. The first call asks the service for the approaches or trials to draw from.
        If you send the call twice, both replies name the same episode.
        """
        return practise_call(self._draw(random, trial))

    def exchange(self, calls: Sequence[EpisodeCall], patience: float | None = None) -> list[Result]:
        """Return the results of any number of calls; raises as :meth:`DriveConnection.exchange`.

        They are repeated for ``patience`` seconds, by default this practice's.
        """
        if self._connection is None:
            self._connection = self.client.connection(self._parallel)
        self._connection.patience = self.patience if patience is None else patience
        parts = [calls[begin : begin + CALLS] for begin in range(0, len(calls), CALLS)]
        return [result for part in parts for result in self._connection.exchange(part)]

    def abort(self, episodes: Sequence[str | None]) -> None:
        """End episodes, which otherwise keep their simulators until the service gives them up."""
        calls = [[Call.ABORT.value, episode] for episode in episodes if episode is not None]
        if self._connection is not None and calls:
            with contextlib.suppress(WrongturnError):
                self.exchange(calls, min(_GOODBYE, self.patience))

    def close(self) -> None:
        """Close the connections; the next call opens them again."""
        for one in (self._connection, self._client):
            if one is not None:
                one.close()
        self._connection = self._client = None

    def _make(self) -> Client:
        return Client(self._url, self._token, transport=self._transport, patience=self.patience)

    def _draw(self, random: np.random.Generator, trial: str | None) -> PracticeRequest:
        options = self._options
        if options.suite is not None:
            if trial is None:
                self._trials = self._trials or self._trials_of(options.suite)
                trial = self._trials[int(random.integers(len(self._trials)))]
            return PracticeRequest(suite=options.suite, trial=trial, track=options.track)
        if trial is not None:
            raise OptionError(f"options: the trial {trial!r} needs an environment that was made with its suite")
        if options.task is not None:  # a journey may begin anywhere
            approach, weather = options.approach, options.draw_weather(random)
            seed = options.draw_seed(random)
        else:
            self._approaches = self._approaches or self._suitable_approaches()
            approach = self._approaches[int(random.integers(len(self._approaches)))]
            seed, weather = options.draw_seed(random), options.draw_weather(random)
        return PracticeRequest(
            town=options.town or DEFAULT_TOWN,
            approach=approach,
            task=options.task,
            route=options.route,
            fault=options.fault,
            weather=weather,
            traffic=options.traffic,
            seed=seed,
            track=options.track,
        )

    def _suitable_approaches(self) -> tuple[str, ...]:
        """Return the town's approaches that have the route and where the fault can be applied.

        If the fault can be applied nowhere, it returns all approaches: the service then says why it refuses the fault,
        for example that it is not installed.
        """
        town, fault = self._options.town or DEFAULT_TOWN, self._options.fault.kind
        approaches = self.client.town(town).approaches
        anywhere = any(fault in one.faults for one in approaches)
        found = tuple(sorted(one.id for one in approaches if not anywhere or self._suits(one)))
        if not found:
            offered = ", ".join(sorted({kind for one in approaches for kind in one.faults}))
            raise OptionError(
                f"fault: {fault} can be applied at no such approach of {town}, whose approaches offer {offered}; "
                "take another"
            )
        return found

    def _suits(self, approach: ApproachDetail) -> bool:
        options = self._options
        return options.fault.kind in approach.faults and (options.route is None or options.route in approach.exits)

    def _trials_of(self, suite: str) -> tuple[str, ...]:
        """Return the ids of a suite's open trials and of their twins."""
        found = tuple(name for one in self.client.trials(suite) for name in (one.id, one.twin) if name)
        if not found:
            raise OptionError(f"suite: {suite} shows no trials for practice; take another")
        return found


def practice_token(client: Client, track: Track, rig: Rig | None = None) -> str:
    """Register an agent for practice in a track, and return its token."""
    name = f"practice-{secrets.token_hex(6)}"
    return client.register(name, track, description="Registered for practice.", rig=rig).token
