"""A message means the same however it comes; what breaks WebSocket's own rules ends the connection, not the drive."""

import socket
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from raw_socket import BINARY, connected, frame, upgrade
from service_harness import Agent, RunningService, expect

from wrongturn_protocol import wire

TEXT, CLOSE, PING, PONG = 0x1, 0x8, 0x9, 0xA
LIMIT = wire.LARGEST
LOOKS = [wire.pack_calls(number, [["look", f"none {number}"]]) for number in range(3)]


def told(raw: socket.socket) -> Iterator[tuple[int, bytes]]:
    """Kind and payload of each frame that the service sends, up to the close, which it would wait to see answered."""
    file = raw.makefile("rb")
    while len(head := file.read(2)) == 2:
        size = head[1]
        if size >= 126:
            size = int.from_bytes(file.read(2 if size == 126 else 8), "big")
        kind = head[0] & 0x0F
        yield kind, file.read(size)
        if kind == CLOSE:
            return


@st.composite
def streams(draw: st.DrawFn) -> tuple[list[bytes], int]:
    """The bytes of all messages, in fragments with pings between, cut anywhere; and how many pings there are."""
    data, pings = b"", 0
    for message in LOOKS:
        cuts = sorted(draw(st.lists(st.integers(0, len(message)), max_size=3)))
        parts = [message[begin:end] for begin, end in zip([0, *cuts], [*cuts, len(message)], strict=True)]
        for index, part in enumerate(parts):
            mask = draw(st.binary(min_size=4, max_size=4))
            data += frame(0 if index else BINARY, part, final=index == len(parts) - 1, mask=mask)
            if draw(st.booleans()):
                data += frame(PING, b"here?")
                pings += 1
    cuts = sorted(draw(st.lists(st.integers(1, len(data) - 1), max_size=6)))
    return [data[begin:end] for begin, end in zip([0, *cuts], [*cuts, len(data)], strict=True)], pings


@settings(max_examples=60, suppress_health_check=list(HealthCheck))
@given(stream=streams())
def test_a_message_means_the_same_however_it_comes(
    service: RunningService, agent: Agent, stream: tuple[list[bytes], int]
) -> None:
    pieces, pings = stream
    with connected(service) as raw:
        upgrade(raw, agent.token)
        raw.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        for piece in pieces:
            raw.sendall(piece)
            time.sleep(0.002)  # so that the next comes on its own
        answered: dict[int | None, str] = {}
        frames = told(raw)
        while len(answered) < len(LOOKS) or pings:
            kind, payload = next(frames)
            if kind == PONG:
                pings -= 1
                continue
            assert kind == BINARY
            number, ((status, fields),) = wire.unpack_results(payload)
            assert status == 404
            answered[number] = fields["detail"]
        assert answered == {number: f"there is no episode 'none {number}'" for number in range(3)}


HALF = bytes(LIMIT // 2 + 1)
BROKEN = {
    "a frame without a mask": (b"\x82\x01\x90", 1002, ""),
    "a reserved bit": (frame(BINARY | 0x40, LOOKS[0]), 1002, ""),
    "a kind that there is none of": (frame(0x3, b"x"), 1002, ""),
    "a fragment that nothing began": (frame(0x0, b"x"), 1002, ""),
    "a message within another": (frame(BINARY, b"x", final=False) + frame(BINARY, b"y"), 1002, ""),
    "a ping that is too long": (frame(PING, bytes(126)), 1002, ""),
    "a ping in fragments": (frame(PING, b"x", final=False), 1002, ""),
    "a close code that there is none of": (frame(CLOSE, (1005).to_bytes(2, "big")), 1002, ""),
    "half a close code": (frame(CLOSE, b"\x03"), 1002, ""),
    "text that is none": (frame(TEXT, b"\xff"), 1007, ""),
    "text in fragments": (frame(TEXT, b"te", final=False) + frame(0, b"xt"), 1003, "text-message"),
    "too large in fragments": (frame(BINARY, HALF, final=False) + frame(0, HALF), 1009, "message-too-large"),
    "far too large by its head": (b"\x82\xff" + (3 * LIMIT).to_bytes(8, "big") + b"\x01\x02\x03\x04", 1009, ""),
    "truncated in fragments": (frame(BINARY, LOOKS[0][:3], final=False) + frame(0, b""), 1007, "truncated-message"),
    "text": (frame(TEXT, b"text"), 1003, "text-message"),
    "too large": (frame(BINARY, bytes(LIMIT + 1)), 1009, "message-too-large"),
    "cut off": (frame(BINARY, LOOKS[0][:-1]), 1007, "truncated-message"),
    "empty": (frame(BINARY, b""), 1007, "truncated-message"),
    "two messages in one": (frame(BINARY, LOOKS[0] * 2), 1007, "malformed-message"),
    "no calls": (frame(BINARY, b"\x92\x01\x90"), 1007, "malformed-message"),
}
"""What else is no message, and is cut off anywhere: tests/protocol/test_wire.py."""


@pytest.fixture(scope="module")
def driver(service: RunningService) -> Iterator[tuple[Agent, str]]:
    """An agent and its episode, for all that is refused."""
    with service.agent() as agent:
        yield agent, agent.practise()["id"]


@pytest.mark.parametrize("name", BROKEN)
def test_what_breaks_the_rules_ends_the_connection(
    service: RunningService, driver: tuple[Agent, str], name: str
) -> None:
    (agent, episode), (data, code, kind) = driver, BROKEN[name]
    seq = expect(agent.http.get(f"/v1/episodes/{episode}"), 200)["seq"] + 1
    with connected(service) as raw:
        upgrade(raw, agent.token)
        raw.sendall(frame(BINARY, wire.pack_calls(7, [["step", episode, seq, 0.0, 0.0, 1.0]])))
        raw.sendall(data)
        frames = list(told(raw))
    *messages, (last, reason) = frames
    assert (last, int.from_bytes(reason[:2], "big")) == (CLOSE, code)
    results = dict(wire.unpack_results(payload) for sort, payload in messages if sort == BINARY)
    if kind:
        assert reason[2:].decode() == kind
        ((status, fields),) = results[None]
        assert (status, fields["type"]) == (413 if code == 1009 else 400, f"/problems/{kind}")
        assert fields["detail"]
    else:
        assert None not in results
    # What was begun before is not lost by it.
    assert agent.step(episode, seq, {"steer": 0.0, "throttle": 0.0, "brake": 1.0}).json()["seq"] == seq


def test_each_code_that_a_mistake_is_closed_with_is_documented() -> None:
    text = (Path(__file__).parents[2] / "docs/wire.md").read_text("utf-8")
    refused = text.split("## What is refused")[1].split("\n## ")[0]
    for name, (_, code, kind) in BROKEN.items():
        rows = [row for row in refused.splitlines() if row.startswith("|") and f"| {code} |" in row]
        assert any(f"`{kind}`" in row if kind else row.startswith("| none |") for row in rows), name
