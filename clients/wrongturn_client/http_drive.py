"""Driving over HTTP, for services and proxies without the WebSocket."""

from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from itertools import count
from typing import Any, Final

from wrongturn_client.decoding import decode_reply, validated
from wrongturn_client.episode_calls import DriveConnection, EpisodeCall, Result
from wrongturn_client.errors import ApiError
from wrongturn_client.one_thread import OneThread
from wrongturn_client.transport import Reply, Transport, path_of
from wrongturn_protocol import EpisodeDetail, EpisodeReply, StepReply
from wrongturn_protocol.wire import Call

_REPLIES: Final[dict[str, type[StepReply | EpisodeReply | EpisodeDetail]]] = {
    Call.STEP: StepReply,
    Call.NEXT: EpisodeReply,
    Call.PRACTISE: EpisodeReply,
    Call.LOOK: EpisodeDetail,
}


class HttpCalls:
    """Sends the calls of an episode as HTTP requests."""

    def __init__(self, transport: Transport, media_type: str) -> None:
        self.patience = transport.patience
        self._transport = transport
        self._media_type = media_type

    def send(self, call: EpisodeCall, patience: float | None = None) -> dict[str, Any]:
        """Send one call and return the fields of its reply; raises as :meth:`Transport.call`."""
        kind, name, *given = call
        if kind == Call.STEP:
            seq, steer, throttle, brake = given
            body = {"seq": seq, "action": {"steer": steer, "throttle": throttle, "brake": brake}}
            return decode_reply(self._request("POST", f"/v1/episodes/{name}/step", body, patience=patience).message())
        if kind == Call.NEXT:
            path = path_of("v1", "evaluations", name, "episodes")
            return decode_reply(self._request("POST", path, key=given[0], patience=patience).message())
        if kind == Call.PRACTISE:
            return decode_reply(self._request("POST", "/v1/episodes", name, key=given[0], patience=patience).message())
        path = path_of("v1", "episodes", name)
        if kind == Call.ABORT:
            self._request("DELETE", path, patience=patience)
            return {}
        fields: dict[str, Any] = self._request("GET", path, patience=patience).message()
        if isinstance(fields, dict) and fields.get("last_reply"):
            fields["last_reply"] = decode_reply(fields["last_reply"])
        return fields

    def _request(
        self, method: str, path: str, body: Any = None, *, key: str | None = None, patience: float | None
    ) -> Reply:
        headers = {} if key is None else {"Idempotency-Key": key}
        return self._transport.call(
            method, path, body=body, media_type=self._media_type, headers=headers, patience=patience
        )


class HttpDrive(DriveConnection):
    """Connection for driving over HTTP; the calls of a message go side by side."""

    def __init__(self, http: HttpCalls, threads: int) -> None:
        """Open nothing yet. With one of ``threads``, :meth:`submit` waits for the answer."""
        self.patience = http.patience
        self._http = http
        self._alone = OneThread()
        self._threads = ThreadPoolExecutor(threads, "wrongturn-http") if threads > 1 else None
        self._numbers = count()
        self._open: dict[int, list[Future[Result]]] = {}

    def submit(self, calls: Sequence[EpisodeCall]) -> int:
        """Send a message of calls and return its number."""
        number = next(self._numbers)
        self._open[number] = [self._start(call, None) for call in calls]
        return number

    def receive(self) -> tuple[int, list[Result]]:
        """Wait for any answered message and return its number and results."""
        while True:
            for number, futures in self._open.items():
                if all(future.done() for future in futures):
                    del self._open[number]
                    return number, [future.result() for future in futures]
            waiting = [future for futures in self._open.values() for future in futures if not future.done()]
            wait(waiting, return_when=FIRST_COMPLETED)

    def retry_busy(self, calls: Sequence[EpisodeCall], results: list[Result], patience: float | None = None) -> None:
        """Do nothing: over HTTP each call is repeated before its result is known."""

    def exchange(self, calls: Sequence[EpisodeCall], patience: float | None = None) -> list[Result]:
        """Send a message of calls and return their results."""
        with self._alone:
            if len(calls) == 1:
                return [self._result(calls[0], patience)]
            futures = [self._start(call, patience) for call in calls]
            wait(futures)  # after an error too: no call may be under way when the caller repeats it
            return [future.result() for future in futures]

    def close(self) -> None:
        """Wait for open calls and end the threads; open episodes stay open."""
        if self._threads is not None:
            self._threads.shutdown()

    def _start(self, call: EpisodeCall, patience: float | None) -> Future[Result]:
        if self._threads is not None:
            return self._threads.submit(self._result, call, patience)
        done: Future[Result] = Future()
        done.set_result(self._result(call, patience))
        return done

    def _result(self, call: EpisodeCall, patience: float | None) -> Result:
        try:
            fields = self._http.send(call, self.patience if patience is None else patience)
        except ApiError as error:
            return error
        kind = _REPLIES.get(call[0])
        return fields if kind is None else dict(validated(kind, fields))
