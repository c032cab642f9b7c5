"""One agent's calls over HTTP and the socket, whose answers have one form; each is held to the OpenAPI document."""

from collections import Counter
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import msgpack
from served_app import ServedApp
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from wrongturn_protocol import ProblemType, Track, wire
from wrongturn_protocol.observations import decode

JSON, MSGPACK = "application/json", "application/msgpack"
KINDS = {f"/problems/{kind}" for kind in ProblemType} - {"/problems/internal"}
SAME = {
    "step": ("POST", "/v1/episodes/{episode}/step"),
    "next": ("POST", "/v1/evaluations/{evaluation}/episodes"),
    "practise": ("POST", "/v1/episodes"),
    "look": ("GET", "/v1/episodes/{episode}"),
    "abort": ("DELETE", "/v1/episodes/{episode}"),
}
"""What each call of the socket is over HTTP."""


class Way(Enum):
    """How a call is made."""

    JSON = "JSON"
    MSGPACK = "msgpack"
    SOCKET = "socket"


@dataclass(frozen=True)
class Answer:
    """What a call came to, however it was made."""

    status: int
    fields: dict[str, Any] = field(default_factory=dict)
    speed: float | None = None

    @property
    def kind(self) -> str:
        """The problem's type; empty where there is none."""
        return str(self.fields.get("type", "/")).rsplit("/", 1)[-1] if self.status >= 400 else ""


class Answers:
    """Makes calls, counts them, and refuses answers that no document knows of."""

    def __init__(self, served: ServedApp) -> None:
        self.served = served
        self.counts: Counter[str] = Counter()
        """Answers by way, call and status."""
        self._paths: dict[str, Any] = served.app.openapi()["paths"]
        self._sockets: dict[str, ClientConnection] = {}
        self._number = 0

    async def call(self, token: str, way: Way, *call: Any) -> Answer:
        """A call of the socket by whichever way."""
        if way is Way.SOCKET:
            (answer,) = await self.batch(token, [call])
            return answer
        binary = way is Way.MSGPACK
        match call:
            case ("step", episode, seq, steer, throttle, brake):
                body = {"seq": seq, "action": {"steer": steer, "throttle": throttle, "brake": brake}}
                return await self.http(token, "step", {"episode": episode}, body, binary=binary)
            case ("next", evaluation, key):
                return await self.http(token, "next", {"evaluation": evaluation}, key=key, binary=binary)
            case ("practise", request, key):
                return await self.http(token, "practise", {}, request, key=key, binary=binary)
            case (name, episode):
                return await self.http(token, name, {"episode": episode}, binary=binary)
        raise AssertionError(call)

    async def http(
        self,
        token: str,
        call: str | tuple[str, str],
        names: dict[str, str],
        body: object = None,
        *,
        key: str | None = None,
        binary: bool = False,
    ) -> Answer:
        """A request of the OpenAPI document, by its name or by its method and path."""
        method, path = SAME[call] if isinstance(call, str) else call
        headers = {"Accept": MSGPACK if binary else JSON}
        if token:
            headers["Authorization"] = f"Bearer {token}"
        content: dict[str, Any] = {}
        if body is not None and binary:
            headers["Content-Type"] = MSGPACK
            content["content"] = msgpack.packb(body)
        elif body is not None:
            content["json"] = body
        if key is not None:
            headers["Idempotency-Key"] = key
        response = await self.served.http.request(method, path.format(**names), headers=headers, **content)
        told: dict[str, Any] = {}
        if response.content:
            packed = response.headers["content-type"] == MSGPACK
            told = msgpack.unpackb(response.content) if packed else response.json()
        if "Retry-After" in response.headers:
            told[wire.RETRY_AFTER] = int(response.headers["Retry-After"])
        last = told.get("last_reply")
        observation = told.pop("observation", None)
        if last is not None and response.status_code == 200:
            observation = last.pop("observation")
        speed = None if observation is None else float(decode(observation, _track(observation))["speed"][0])
        answer = Answer(response.status_code, told, speed)
        self._check(Way.MSGPACK if binary else Way.JSON, method, path, answer)
        return answer

    async def batch(self, token: str, calls: list[Any]) -> list[Answer]:
        """Calls in one message over the agent's socket, which is opened where there is none."""
        try:
            return await self._sent(token, calls)
        except ConnectionClosed:
            # The service was started again meanwhile.
            del self._sockets[token]
            return await self._sent(token, calls)

    async def _sent(self, token: str, calls: list[Any]) -> list[Answer]:
        socket = self._sockets.get(token)
        if socket is None:
            socket = self._sockets[token] = await self.open(token)
        self._number += 1
        await socket.send(wire.pack_calls(self._number, calls))
        message = await socket.recv()
        assert isinstance(message, bytes)
        number, results = wire.unpack_results(message)
        assert number == self._number, results
        answers = []
        for call, (status, fields, *block) in zip(calls, results, strict=True):
            speed = float(wire.arrays(block[0])["speed"][0]) if block else None
            answers.append(Answer(status, fields, speed))
            name = call[0] if isinstance(call, list | tuple) and call and call[0] in SAME else None
            if name is None:
                assert answers[-1].kind == "validation"
            else:
                self._check(Way.SOCKET, *SAME[name], answers[-1])
        return answers

    async def open(self, token: str) -> ClientConnection:
        """A socket of the caller's own."""
        return await connect(
            self.served.url.replace("http", "ws", 1) + wire.PATH,
            subprotocols=[wire.SUBPROTOCOL],  # type: ignore[list-item]
            additional_headers={"Authorization": f"Bearer {token}"},
            compression=None,
            ping_interval=None,
            proxy=None,
        )

    async def forget(self, token: str) -> None:
        """Close the agent's socket."""
        socket = self._sockets.pop(token, None)
        if socket is not None:
            await socket.close()

    def _check(self, way: Way, method: str, path: str, answer: Answer) -> None:
        self.counts[f"{way.value} {method} {path} {answer.status} {answer.kind}".strip()] += 1
        documented = self._paths[path][method.lower()]["responses"]
        assert str(answer.status) in documented, f"{method} {path} answered {answer.status}: {answer.fields}"
        if answer.status < 400:
            return
        assert answer.fields["type"] in KINDS, answer.fields
        assert answer.fields["status"] == answer.status
        assert answer.fields["detail"]
        if answer.status in {429, 503}:
            assert answer.fields[wire.RETRY_AFTER] >= 1


def _track(observation: dict[str, Any]) -> Track:
    return Track.PRIVILEGED if "lane" in observation else Track.STATE
