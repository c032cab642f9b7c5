"""A real service in a process of its own, and an agent that talks to it by plain HTTP."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx

READY = "Wrongturn is ready at "
OPERATOR = "the-operators-own-token"
COAST = {"steer": 0.0, "throttle": 0.0, "brake": 0.0}
GAS = {"steer": 0.0, "throttle": 0.8, "brake": 0.0}


def metrics(url: str) -> str:
    """What Prometheus reads. It needs a token where the service has an operator."""
    response = httpx.get(f"{url}/metrics", headers={"Authorization": f"Bearer {OPERATOR}"}, timeout=60)
    assert response.is_success, response.text
    return response.text


def figure(service: "Service", name: str) -> float:
    """One of the service's figures; 0 where there is none of that name yet."""
    lines = metrics(service.url).splitlines()
    return next((float(line.rsplit(" ", 1)[1]) for line in lines if line.startswith(name + " ")), 0.0)


def await_that(condition: Callable[[], bool], message: str, seconds: float = 120) -> None:
    """Wait until something is so."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, message
        time.sleep(0.01)


class Service:
    """A service that listens at a URL."""

    url: str

    @contextlib.contextmanager
    def agent(self, track: str = "privileged", **fields: object) -> Iterator["Agent"]:
        """Register an agent; at the end its open episodes are deleted."""
        with httpx.Client(base_url=self.url, timeout=60) as http:
            body = {"name": f"agent {uuid.uuid4().hex[:12]}", "track": track, **fields}
            registered = expect(http.post("/v1/agents", json=body), 201)
        with Agent(self.url, registered) as agent:
            yield agent


@contextlib.contextmanager
def running_service(database: Path, **settings: object) -> Iterator["RunningService"]:
    """A service that tests share; it has to start, to log no error and to end well."""
    running = RunningService(database, **settings)
    if not running.ready:
        running.kill()
        raise AssertionError(f"the service did not start: {running.stderr}")
    yield running
    assert running.stop() == 0, running.stderr
    assert '"level": "error"' not in running.stderr, running.stderr


class RunningService(Service):
    """One ``wrongturn serve`` on a free loopback port, in a process of its own."""

    def __init__(self, database: Path, *options: str, **settings: object) -> None:
        self.database = database
        # A spare simulator takes a core for seconds; the tests that are about it ask for one.
        settings.setdefault("spare_simulators", 0)
        # To look for a sandbox takes half a second. Those who hand models in ask for it.
        settings.setdefault("submissions", 0)
        environment = {name: value for name, value in os.environ.items() if not name.startswith("WRONGTURN_")}
        if "WRONGTURN_HOME" in os.environ:
            environment["WRONGTURN_HOME"] = os.environ["WRONGTURN_HOME"]
        environment |= {f"WRONGTURN_{name.upper()}": str(value) for name, value in settings.items()}
        url = f"sqlite+aiosqlite:///{database}"
        self.process = subprocess.Popen(
            [sys.executable, "-m", "wrongturn_client", "serve", "--port", "0", "--database", url, *options],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        self._said: list[str] = []
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        self._reader = threading.Thread(target=self._read, args=(self.process.stderr,), daemon=True)
        self._reader.start()
        line = self.process.stdout.readline()
        self.url = line.removeprefix(READY).strip() if line.startswith(READY) else ""
        self.ready = bool(self.url)

    def _read(self, stream: Any) -> None:
        for line in stream:
            self._said.append(line)

    @property
    def stderr(self) -> str:
        if self.process.poll() is not None:
            self._reader.join(60)
        return "".join(self._said)

    def simulators(self) -> list[int]:
        """Process ids of its simulators."""
        children = Path(f"/proc/{self.process.pid}/task").glob("*/children")
        pids = {int(pid) for path in children for pid in _text(path).split()}
        return sorted(pid for pid in pids if _is_simulator(pid))

    def stop(self) -> int:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        return self._end()

    def kill(self) -> None:
        self.process.kill()
        self._end()

    def _end(self) -> int:
        try:
            status = self.process.wait(120)
        except subprocess.TimeoutExpired:
            self.process.kill()
            status = self.process.wait()
        self._reader.join(60)
        assert self.process.stdout is not None
        assert self.process.stderr is not None
        self.process.stdout.close()
        self.process.stderr.close()
        return status


class Agent:
    """One registered agent."""

    def __init__(self, url: str, registered: dict[str, Any]) -> None:
        self.id: str = registered["id"]
        self.name: str = registered["name"]
        self.token: str = registered["token"]
        self._open: list[str] = []
        self.http = httpx.Client(base_url=url, timeout=60, headers={"Authorization": f"Bearer {self.token}"})

    def __enter__(self) -> "Agent":
        return self

    def __exit__(self, *_: object) -> None:
        for episode in self._open:
            # Its simulator is for the next test, where the service is still there.
            with contextlib.suppress(httpx.HTTPError):
                self.http.delete(f"/v1/episodes/{episode}")
        self.http.close()

    def practise(self, **fields: object) -> dict[str, Any]:
        body = {"town": "Town01", "approach": "J3-S", "seed": 3, **fields}
        if "suite" in fields:
            del body["town"], body["approach"], body["seed"]
        episode = expect(patiently(lambda: self.http.post("/v1/episodes", json=body)), 201)
        self._open.append(episode["id"])
        return episode

    def step(self, episode: str, seq: int, action: dict[str, float] = GAS) -> httpx.Response:
        body = {"seq": seq, "action": action}
        return patiently(lambda: self.http.post(f"/v1/episodes/{episode}/step", json=body))

    def evaluate(self, suite: str = "smoke@3") -> dict[str, Any]:
        return expect(self.http.post("/v1/evaluations", json={"suite": suite}), 201)

    def reset(self, evaluation: str, **headers: str) -> httpx.Response:
        return patiently(lambda: self.http.post(f"/v1/evaluations/{evaluation}/episodes", headers=headers))

    def drive(self, episode: str, action: dict[str, float] = GAS, begin: int = 1) -> tuple[int, dict[str, Any]]:
        """Step until the end; the number of the last step and its reply."""
        seq = begin
        while True:
            reply = expect(self.step(episode, seq, action), 200)
            if reply["terminated"] or reply["truncated"]:
                return seq, reply
            seq += 1

    def trajectory(self, episode: str) -> bytes:
        response = self.http.get(f"/v1/episodes/{episode}/trajectory")
        assert response.status_code == 200, response.text
        return response.content


def patiently(call: Callable[[], httpx.Response], seconds: float = 240) -> httpx.Response:
    """Call again as long as simulators are being started, which takes long on a busy machine; the last response."""
    deadline = time.monotonic() + seconds
    while True:
        response = call()
        if response.status_code != 503 or "are being started" not in response.text or time.monotonic() > deadline:
            return response
        time.sleep(0.5)


def expect(response: httpx.Response, status: int) -> dict[str, Any]:
    """The body of a good reply."""
    assert response.status_code == status, f"{response.status_code}: {response.text[:500]}"
    body = response.json()
    assert isinstance(body, dict)
    return body


def problem(response: httpx.Response, status: int, kind: str, path: str | None = None) -> dict[str, Any]:
    """The body of a refusal, which has to be a problem of this type."""
    assert response.status_code == status, f"{response.status_code}: {response.text[:500]}"
    assert response.headers["content-type"] == "application/problem+json"
    body = response.json()
    assert isinstance(body, dict)
    assert body["type"] == f"/problems/{kind}", body
    assert body["status"] == status
    assert body["title"]
    assert body["detail"]
    if path is not None:
        assert path in [error["path"] for error in body["errors"]], body
    return body


def _is_simulator(pid: int) -> bool:
    """Return whether a child of the service is a simulator. One that was just forked is still a copy of the service."""
    return "wrongturn_service.simulators\0" in _text(Path(f"/proc/{pid}/cmdline"))


def _text(path: Path) -> str:
    """What a file of a process or thread says; nothing once that is gone."""
    with contextlib.suppress(FileNotFoundError, ProcessLookupError):
        return path.read_text()
    return ""
