"""The OpenEnv server before the service in memory: messages, errors, sessions and the calls over HTTP."""

import json
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import SimpleNamespace
from typing import Any

import pytest
from client_fake_service import FakeService, problem
from starlette.testclient import TestClient
from typer.testing import CliRunner
from websockets.sync.client import connect

from wrongturn_client import WrongturnError
from wrongturn_client.cli import app
from wrongturn_openenv.app import create_app
from wrongturn_openenv.server import READY
from wrongturn_openenv.session import Service
from wrongturn_protocol import ProblemType, Track
from wrongturn_protocol.observations import decode, observation_space

GAS = {"steer": 0.25, "throttle": 0.5, "brake": 0.0}


@contextmanager
def _server(fake: FakeService, sessions: int = 4, **more: Any) -> Iterator[TestClient]:
    service = Service("http://fake", transport=fake.transport, **more)
    with TestClient(create_app(service, sessions)) as client:
        yield client


def _ask(socket: Any, kind: str, **data: Any) -> dict[str, Any]:
    socket.send_text(json.dumps({"type": kind, "data": data} if kind != "state" else {"type": kind}))
    answer: dict[str, Any] = socket.receive_json()
    return answer


@pytest.mark.parametrize("track", list(Track))
def test_an_episode_from_reset_to_its_verdict(track: Track) -> None:
    fake = FakeService(track=track)
    with _server(fake) as client, client.websocket_connect("/ws") as socket:
        assert _ask(socket, "state")["data"]["episode_id"] is None
        begun = _ask(socket, "reset", seed=1, track=track)
        assert begun["type"] == "observation"
        assert (begun["data"]["reward"], begun["data"]["done"]) == (None, False)
        for done in (False, False, True):
            reply = _ask(socket, "step", **GAS, metadata={})["data"]  # as OpenEnv's typed clients send it
            assert (reply["reward"], reply["done"]) == (1.5, done)
            assert observation_space(track).contains(decode(reply["observation"], track))
        state = _ask(socket, "state")["data"]
    assert state == {
        "episode_id": "ep0",
        "step_count": 3,
        "track": track,
        "town": "Town01",
        "trial": "t1",
        "terminated": True,
        "truncated": False,
        "verdict": "exit_route",
        "lost": None,
    }
    assert fake.seen["ep0"] == [tuple(GAS.values())] * 3


def test_a_reset_names_trials_as_the_gymnasium_environment_does() -> None:
    fake = FakeService()
    defaults = {"town": "Town02", "fault": "omission"}
    with _server(fake, defaults=defaults) as client, client.websocket_connect("/ws") as socket:
        _ask(socket, "reset", seed=3)
        _ask(socket, "reset", fault={"kind": "infeasible"}, weather=["WetNoon"], traffic={"vehicles": 2}, route=1)
        _ask(socket, "reset", town=None, suite="smoke@3", fault=None, trial="one")
        _ask(socket, "reset", seed=3, episode_id="mine")
        assert _ask(socket, "state")["data"]["episode_id"] == "mine"
    first, second, third, fourth = fake.practice
    assert (first["town"], first["fault"]["kind"]) == ("Town02", "omission")
    assert (second["fault"]["kind"], second["weather"], second["traffic"]["vehicles"]) == ("infeasible", "WetNoon", 2)
    assert (third["suite"], third["trial"]) == ("smoke@3", "one")
    assert fourth == first, "the same seed and options begin the same trial"


def test_sessions_are_apart_and_share_an_agent_for_each_track() -> None:
    fake = FakeService(track=Track.CAMERA)
    with _server(fake) as client, client.websocket_connect("/ws") as one, client.websocket_connect("/ws") as two:
        _ask(one, "reset")
        _ask(two, "reset", track="state")
        _ask(one, "step", **GAS)
        states = [_ask(socket, "state")["data"] for socket in (one, two)]
        assert [(state["episode_id"], state["step_count"]) for state in states] == [("ep0", 1), ("ep1", 0)]
        _ask(two, "reset", track="camera", town="Town02")
    registered = [json.loads(one.content) for one in fake.requests if one.url.path == "/v1/agents"]
    assert [one["track"] for one in registered] == ["state", "camera"]


def test_who_leaves_ends_the_episode() -> None:
    fake = FakeService()
    with _server(fake, token="mine") as client:
        with client.websocket_connect("/ws") as socket:
            _ask(socket, "reset")
            _ask(socket, "reset", town="Town02")
            assert fake.aborted == ["ep0"]
            socket.send_json({"type": "close"})
            assert socket.receive()["type"] == "websocket.close"
        with client.websocket_connect("/ws") as socket:
            _ask(socket, "reset")
        client.post("/reset")
        for _ in range(600):  # a thread ends the episode of who left
            if len(fake.aborted) == 3:
                break
            time.sleep(0.1)
    assert sorted(fake.aborted) == ["ep0", "ep1", "ep2", "ep3"]
    assert not fake.paths("POST").count("/v1/agents")


@pytest.mark.parametrize(
    ("text", "code", "says"),
    [
        (b"\x00", "INVALID_JSON", ""),
        ("{", "INVALID_JSON", "no JSON"),
        ("[" * 100_000, "INVALID_JSON", "no JSON"),
        ('{"data": {}}', "UNKNOWN_TYPE", "type"),
        ('{"type": "jump"}', "UNKNOWN_TYPE", "'jump'"),
        ('{"type": "reset", "extra": 1}', "VALIDATION_ERROR", "extra"),
        ('{"type": "reset", "data": {"seed": -1}}', "VALIDATION_ERROR", "seed"),
        ('{"type": "reset", "data": {"sed": 1}}', "VALIDATION_ERROR", "Did you mean seed?"),
        ('{"type": "reset", "data": {"track": "sonar"}}', "VALIDATION_ERROR", "track: 'sonar'"),
        ('{"type": "reset", "data": {"fault": {"kind": "rain"}}}', "VALIDATION_ERROR", "fault"),
        ('{"type": "reset", "data": {"traffic": {"vehicles": -1}}}', "VALIDATION_ERROR", "vehicles"),
        ('{"type": "reset", "data": {"suite": "smoke@3", "town": "Town01"}}', "VALIDATION_ERROR", "suite"),
        ('{"type": "step"}', "VALIDATION_ERROR", "action.steer is missing"),
        ('{"type": "step", "data": {"steer": NaN, "throttle": 0, "brake": 0}}', "VALIDATION_ERROR", "action.steer"),
        ('{"type": "step", "data": {"steer": 0, "throttle": 2, "brake": 0}}', "VALIDATION_ERROR", "action.throttle"),
        ('{"type": "step", "data": {"steer": 0, "throttle": 0, "brake": 0, "gear": 1}}', "VALIDATION_ERROR", "gear"),
        ('{"type": "step", "data": {"steer": 0, "throttle": 0, "brake": 1}}', "EXECUTION_ERROR", "call reset"),
    ],
)
def test_errors_say_what_to_give_and_the_session_goes_on(text: str | bytes, code: str, says: str) -> None:
    with _server(FakeService()) as client, client.websocket_connect("/ws") as socket:
        (socket.send_text if isinstance(text, str) else socket.send_bytes)(text)
        answer = socket.receive_json()
        assert answer["type"] == "error"
        assert answer["data"]["code"] == code
        assert says in answer["data"]["message"]
        assert "\n" not in answer["data"]["message"]
        assert _ask(socket, "reset")["type"] == "observation"


def test_steps_after_the_end_are_refused_until_the_next_reset() -> None:
    with _server(FakeService(steps=1)) as client, client.websocket_connect("/ws") as socket:
        _ask(socket, "reset")
        assert _ask(socket, "step", **GAS)["data"]["done"]
        refused = _ask(socket, "step", **GAS)["data"]
        assert (refused["code"], refused["message"]) == ("EXECUTION_ERROR", "step after the end; call reset")
        _ask(socket, "reset")
        assert _ask(socket, "state")["data"]["verdict"] is None


def test_an_episode_that_the_service_gave_up_is_over() -> None:
    fake = FakeService()
    with _server(fake) as client, client.websocket_connect("/ws") as socket:
        _ask(socket, "reset")
        fake.lost.add("ep0")
        assert _ask(socket, "step", **GAS)["data"]["done"]
        state = _ask(socket, "state")["data"]
    assert (state["truncated"], state["step_count"]) == (True, 0)
    assert state["lost"]


def test_a_service_that_refuses_is_quoted() -> None:
    fake = FakeService()
    with _server(fake) as client, client.websocket_connect("/ws") as socket:
        fake.inject = lambda request: problem(ProblemType.UNAUTHENTICATED, 401, "registration is closed")
        answer = _ask(socket, "reset")["data"]
        assert (answer["code"], answer["message"]) == ("EXECUTION_ERROR", "registration is closed")
        assert client.get("/health").json() == {"status": "unhealthy"}
        fake.inject = None
        assert _ask(socket, "reset")["type"] == "observation"


def _known(*tokens: str) -> Any:
    """An injection: the service knows these tokens alone."""

    def answer(request: Any) -> Any:
        token = request.headers.get("authorization")
        known = token is None or token.removeprefix("Bearer ") in tokens
        return None if known else problem(ProblemType.UNAUTHENTICATED, 401, "the token is unknown")

    return answer


def test_an_agent_that_the_service_does_not_know_any_more_is_registered_again() -> None:
    fake = FakeService()
    with _server(fake) as client, client.websocket_connect("/ws") as one, client.websocket_connect("/ws") as two:
        _ask(one, "reset", seed=3)
        _ask(two, "reset", seed=4)
        fake.token, fake.inject = "second", _known("second")
        assert _ask(one, "step", **GAS)["data"]["message"] == "the token is unknown"
        assert _ask(one, "reset", seed=3)["type"] == "observation"
        assert _ask(two, "reset", seed=3)["type"] == "observation"
        assert fake.paths("POST").count("/v1/agents") == 2, "sessions share the new agent"
        assert fake.practice[0] == fake.practice[2]
        fake.inject = _known()
        assert _ask(one, "reset")["data"]["message"] == "the token is unknown"
        assert fake.paths("POST").count("/v1/agents") == 3, "it tries once"


def test_a_token_that_was_given_is_never_replaced() -> None:
    fake = FakeService()
    with _server(fake, token="mine") as client, client.websocket_connect("/ws") as socket:
        fake.inject = _known()
        answer = _ask(socket, "reset")["data"]
        assert (answer["code"], answer["message"]) == ("EXECUTION_ERROR", "the token is unknown")
    assert "/v1/agents" not in fake.paths("POST")


def test_health_and_ends_of_sessions_do_not_queue_behind_resets() -> None:
    fake, begins, go = FakeService(), threading.Semaphore(0), threading.Event()

    def wait(request: Any) -> None:
        if request.method == "POST" and request.url.path == "/v1/episodes":
            begins.release()
            go.wait(120)

    with _server(fake, sessions=2) as client, client.websocket_connect("/ws") as one:
        _ask(one, "reset")
        with client.websocket_connect("/ws") as two:
            fake.inject = wait  # type: ignore[assignment]
            two.send_text('{"type": "reset"}')
            http = threading.Thread(target=client.post, args=("/reset",))
            http.start()
            assert begins.acquire(timeout=120)
            assert begins.acquire(timeout=120)
            assert client.get("/health").json() == {"status": "healthy"}
            one.send_json({"type": "close"})
            assert one.receive()["type"] == "websocket.close"
            while fake.aborted != ["ep0"]:
                time.sleep(0.01)
            go.set()
            assert two.receive_json()["type"] == "observation"
            http.join()


def test_a_stop_does_not_wait_for_a_busy_service(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: set[str] = set()

    class Busy(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.add(self.path)
            self.send_response(200 if self.path.startswith("/health") else 503)
            self.send_header("content-length", "0")
            self.end_headers()

        def log_message(self, *_: Any) -> None:
            pass

    monkeypatch.setenv("WRONGTURN_TOKEN", "mine")
    busy = ThreadingHTTPServer(("127.0.0.1", 0), Busy)
    threading.Thread(target=busy.serve_forever, daemon=True).start()
    url = f"http://127.0.0.1:{busy.server_port}"
    command = [sys.executable, "-m", "wrongturn_client", "openenv", "--url", url, "--port", "0"]
    with busy, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        address = process.stdout.readline().removeprefix(f"{READY}http://").strip()
        host, port = address.split(":")
        with connect(f"ws://{address}/ws") as one, socket.create_connection((host, int(port))) as two:
            one.send('{"type": "reset", "data": {"town": "Town02"}}')
            two.sendall(b"POST /reset HTTP/1.1\r\nhost: here\r\ncontent-length: 0\r\n\r\n")
            while len(asked) < 3:  # the health, and a town for each reset
                time.sleep(0.01)
            begun = time.monotonic()
            process.send_signal(signal.SIGTERM)
            assert process.wait(120) == 0
            took = time.monotonic() - begun
            assert b"the server stops" in two.recv(4096)
        assert process.stderr.read() == ""
        busy.shutdown()
    assert took < 30, "the patience with a busy service is 45 s"


def test_one_session_too_many_is_told_so() -> None:
    with _server(FakeService(), sessions=1) as client:
        with client.websocket_connect("/ws") as first, client.websocket_connect("/ws") as second:
            answer = second.receive_json()["data"]
            assert answer["code"] == "CAPACITY_REACHED"
            assert "--sessions" in answer["message"]
            assert second.receive()["code"] == 1013
            assert _ask(first, "reset")["type"] == "observation"
        with client.websocket_connect("/ws") as third:
            assert _ask(third, "reset")["type"] == "observation"


def test_the_calls_over_http_share_a_session() -> None:
    with _server(FakeService()) as client:
        assert client.post("/step", json={"action": GAS}).status_code == 409
        assert client.post("/reset", json={"seed": 1}).json()["done"] is False
        assert client.post("/step", json={"action": GAS, "timeout_s": 5.0}).json()["reward"] == 1.5
        assert client.get("/state").json()["step_count"] == 1
        refused = client.post("/step", json={"action": {**GAS, "brake": 2}})
        assert (refused.status_code, refused.json()["detail"]) == (422, "action.brake is 2; give a number from 0 to 1")
        assert client.post("/reset", json={"track": "sonar"}).status_code == 422
        assert client.post("/reset", json={"sed": 1}).status_code == 422
        assert client.post("/step", json={}).status_code == 422


def test_what_openenvs_validator_asks_for() -> None:
    with _server(FakeService(), defaults={"track": "camera"}) as client:
        assert client.get("/health").json() == {"status": "healthy"}
        assert client.get("/metadata").json()["name"] == "Wrongturn"
        schema = client.get("/schema").json()
        assert set(schema["action"]["properties"]) == {"steer", "throttle", "brake"}
        assert "rgb" in schema["observation"]["properties"]
        assert "verdict" in schema["state"]["properties"]
        openapi = client.get("/openapi.json").json()
        for name in ("Reply", "StepRequest", "State"):
            assert all(one.get("description") for one in openapi["components"]["schemas"][name]["properties"].values())
        assert openapi["info"]["version"].startswith("1.")
        assert {"/reset", "/step", "/state"} <= openapi["paths"].keys()
        assert client.post("/mcp", json={}).json()["jsonrpc"] == "2.0"


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (["--track", "sonar"], "--track: 'sonar' is unknown"),
        (["--fault", "infeasable"], "Did you mean infeasible?"),
        (["--suite", "smoke@3", "--town", "Town01"], "--suite: its trials name their towns"),
        (["--url", "nowhere"], "http://"),
        (["--url", "http://127.0.0.1:9"], "no Wrongturn service answers"),
        (["--host", "192.0.2.1"], "--host 192.0.2.1"),
    ],
)
def test_wrong_options_are_told_before_anything_starts(given: list[str], says: str) -> None:
    result = CliRunner().invoke(app, ["openenv", "--port", "0", *given])
    assert isinstance(result.exception, WrongturnError)
    assert says in str(result.exception)


def test_a_service_of_its_own_gets_no_settings_and_no_token_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    fake, started, ran = FakeService(), [], []

    def service(**given: Any) -> Any:
        started.append(given)
        return nullcontext(SimpleNamespace(url="http://own"))

    monkeypatch.setenv("WRONGTURN_TOKEN", "of another service")
    monkeypatch.delenv("WRONGTURN_URL", raising=False)
    monkeypatch.setattr("wrongturn_client.local_service.LocalService", service)
    monkeypatch.setattr("wrongturn_openenv.session.Service.check", lambda self: None)
    monkeypatch.setattr("wrongturn_openenv.server.run", lambda service, *_: ran.append(service))
    assert CliRunner().invoke(app, ["openenv", "--port", "0"]).exit_code == 0
    assert started[0]["environment"]["WRONGTURN_REGISTRATION"] == "open"
    assert (ran[0].url, ran[0].token) == ("http://own", None)
    with _server(fake) as client:
        assert client.post("/reset").status_code == 200
    (registration,) = [one for one in fake.requests if one.url.path == "/v1/agents"]
    assert "authorization" not in registration.headers


def test_an_unknown_town_of_the_server_is_told_at_its_start() -> None:
    fake = FakeService()
    unknown = problem(ProblemType.UNKNOWN_TOWN, 404, "no town Town99")
    fake.inject = lambda request: unknown if request.url.path.endswith("Town99") else None
    with pytest.raises(WrongturnError, match="Town99"):
        Service("http://fake", defaults={"town": "Town99"}, transport=fake.transport).check()
    Service("http://fake", defaults={"town": "Town02"}, transport=fake.transport).check()
