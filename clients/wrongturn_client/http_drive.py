"""Driving over HTTP, for services and proxies without the WebSocket."""

import uuid
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, Final

from wrongturn_client.episode_calls import DriveConnection, EpisodeCall, EpisodeCalls, Result, decoded, validated
from wrongturn_client.errors import ApiError, ProtocolError
from wrongturn_client.transport import Transport, path_of
from wrongturn_protocol import Command, EpisodeDetail, EpisodeReply, StepReply, WhatIfRequest
from wrongturn_protocol.wire import Call

_REPLIES: Final[dict[str, type[StepReply | EpisodeReply | EpisodeDetail]]] = {
    Call.STEP: StepReply,
    Call.NEXT: EpisodeReply,
    Call.PRACTISE: EpisodeReply,
    Call.LOOK: EpisodeDetail,
}


class HttpCalls(EpisodeCalls):
    """Sends the calls of an episode as HTTP requests."""

    _transport: Transport
    _media_type: str
    """That of requests and replies: msgpack or JSON."""

    def whatif(self, episode: str, at: float, command: Command | None = None) -> EpisodeReply:
        """Begin a fork of a finished episode as practice (the reset), and drive it by :meth:`step`.

        The service delivers the episode's commands up to ``at``, seconds after the start, and then ``command``; None is
        the route's, which is right. Up to there it takes the episode's actions alone.

        Raises:
            ConflictError: The episode is not finished; or in a step, the action is not the episode's.
        """
        body = WhatIfRequest(episode=episode, at=at, command=command).model_dump(mode="json")
        answer = self._transport.call(
            "POST", "/v1/whatifs", body=body, media_type=self._media_type, key=str(uuid.uuid4())
        )
        return validated(EpisodeReply, _with_arrays(answer.message()))

    def _send(self, call: EpisodeCall, patience: float) -> dict[str, Any]:
        """Send one call and return the fields of its reply; raises as :meth:`Transport.call`."""
        method, path, body, key = _request_of(call)
        answer = self._transport.call(method, path, body=body, media_type=self._media_type, key=key, patience=patience)
        if call[0] == Call.ABORT:
            return {}
        fields: dict[str, Any] = answer.message()
        if call[0] != Call.LOOK:
            return _with_arrays(fields)
        if isinstance(fields, dict) and fields.get("last_reply"):
            fields["last_reply"] = _with_arrays(fields["last_reply"])
        return fields

    def _answer(self, call: EpisodeCall) -> Result:
        try:
            return self._send(call, self._transport.patience)
        except ApiError as error:
            return error


def _request_of(call: EpisodeCall) -> tuple[str, str, Any, str | None]:
    """Return method, path, body and idempotency key of the request for a call."""
    kind, subject, *given = call
    if kind == Call.STEP:
        seq, steer, throttle, brake = given
        body = {"seq": seq, "action": {"steer": steer, "throttle": throttle, "brake": brake}}
        return "POST", f"/v1/episodes/{subject}/step", body, None
    if kind == Call.NEXT:
        return "POST", path_of("v1", "evaluations", subject, "episodes"), None, given[0]
    if kind == Call.PRACTISE:
        return "POST", "/v1/episodes", subject, given[0]
    return "DELETE" if kind == Call.ABORT else "GET", path_of("v1", "episodes", subject), None, None


def _with_arrays(reply: Any) -> dict[str, Any]:
    """Return the reply to a reset or a step, with its observation as arrays; raise ProtocolError if it is none."""
    if not isinstance(reply, dict) or "observation" not in reply:
        raise ProtocolError("the answer has no observation; are the service and this client of the same version?")
    observation = reply["observation"]
    if not isinstance(observation, Mapping):
        raise ProtocolError(f"an observation must be an object, not {type(observation).__name__}")
    try:
        reply["observation"] = decoded(observation)
    except (ValueError, KeyError, TypeError) as error:
        raise ProtocolError(f"an observation cannot be read: {error}") from error
    return reply


class HttpDrive(DriveConnection):
    """Connection for driving over HTTP; the calls of a message go side by side, and each repeats itself."""

    def __init__(self, http: HttpCalls, patience: float, threads: int) -> None:
        super().__init__(patience)
        self._http = http
        self._threads = ThreadPoolExecutor(threads, "wrongturn-http")

    def exchange(self, calls: Sequence[EpisodeCall]) -> list[Result]:
        """Send a message of calls and return their results."""
        with self._alone:
            if len(calls) == 1:
                return [self._result(calls[0])]
            futures = [self._threads.submit(self._result, call) for call in calls]
            wait(futures)  # after an error too: no call may be under way when the caller repeats it
            return [future.result() for future in futures]

    def close(self) -> None:
        """Wait for open calls and end the threads; open episodes stay open."""
        self._threads.shutdown()

    def _result(self, call: EpisodeCall) -> Result:
        try:
            fields = self._http._send(call, self.patience)
        except ApiError as error:
            return error
        kind = _REPLIES.get(call[0])
        return fields if kind is None else dict(validated(kind, fields))
