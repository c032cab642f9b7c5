"""One compose project for all soak tests of the containers, and what they share."""

import json
import os
import shutil
import socket
import subprocess
import time
import urllib.error
import urllib.request
import uuid
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


def compose_program() -> list[str]:
    """Compose as a plugin or as a program of its own; skips where there is no engine to drive."""
    if shutil.which("docker") is None:
        pytest.skip("there is no docker program here")
    if subprocess.run(["docker", "info"], capture_output=True, check=False).returncode:
        pytest.skip("no Docker engine answers here; start one to run this")
    if subprocess.run(["docker", "compose", "version"], capture_output=True, check=False).returncode == 0:
        return ["docker", "compose"]
    if shutil.which("docker-compose") is None:
        pytest.skip("there is neither docker compose nor docker-compose here")
    return ["docker-compose"]


def free_port() -> int:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        return taken.getsockname()[1]


def inspect(container: str, field: str) -> str:
    command = ["docker", "inspect", "-f", field, container]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


class Service:
    """One compose project of its own name, port and volume."""

    def __init__(self, secrets: Path, *overrides: Path) -> None:
        self.port = free_port()
        self.secrets = secrets
        self.settings = secrets.with_name("service.env")
        self.settings.touch()
        self.environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("WRONGTURN_")},
            "WRONGTURN_PORT": str(self.port),
            "WRONGTURN_SECRETS": str(secrets),
            "WRONGTURN_ENV_FILE": str(self.settings),
            "WRONGTURN_SUITE": "smoke@3",
        }
        project = f"wrongturntest{uuid.uuid4().hex[:8]}"
        files = [option for file in (ROOT / "docker" / "compose.yaml", *overrides) for option in ("-f", str(file))]
        self.command = [*compose_program(), "-p", project, *files]

    def compose(self, *arguments: str) -> str:
        done = subprocess.run(
            [*self.command, *arguments], env=self.environment, cwd=ROOT, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{arguments}: {done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return done.stdout

    def up(self) -> None:
        self.compose("up", "-d")
        self.wait_until_ready()

    def wait_until_ready(self) -> None:
        deadline = time.monotonic() + 300
        while self.call("GET", "/health/ready").status != 200:
            # A service that ends at once is started again and again; waiting for that one is of no use.
            hopeless = time.monotonic() > deadline or int(inspect(self.container(), "{{.RestartCount}}")) > 2
            assert not hopeless, f"not ready:\n{self.compose('logs')[-5000:]}"
            time.sleep(1)

    def call(self, method: str, path: str, body: object = None, token: str | None = None) -> SimpleNamespace:
        request = urllib.request.Request(f"http://127.0.0.1:{self.port}{path}", method=method)
        if token:
            request.add_header("Authorization", f"Bearer {token}")
        if body is not None:
            request.add_header("Content-Type", "application/json")
            request.data = json.dumps(body).encode()
        try:
            with urllib.request.urlopen(request, timeout=30) as reply:
                return SimpleNamespace(status=reply.status, body=reply.read())
        except urllib.error.HTTPError as refusal:
            return SimpleNamespace(status=refusal.code, body=refusal.read())
        except OSError as broken:
            return SimpleNamespace(status=0, body=repr(broken).encode())

    def container(self) -> str:
        return self.compose("ps", "-q", "service").strip()


def entries(service: Service) -> list[dict[str, Any]]:
    board = service.call("GET", "/v1/leaderboards/smoke@3")
    assert board.status == 200, board.body
    return json.loads(board.body)["entries"]


def register(service: Service, name: str, track: str = "privileged") -> dict[str, str]:
    reply = service.call("POST", "/v1/agents", {"name": name, "track": track})
    assert reply.status == 201, reply.body
    return json.loads(reply.body)


def ids_in(listing: object) -> list[str]:
    """Ids of a list, bare or under a key."""
    rows = listing if isinstance(listing, list) else next(iter(listing.values()))
    return [row["id"] for row in rows]


def first_trial(service: Service) -> str:
    return ids_in(json.loads(service.call("GET", "/v1/suites/smoke@3/trials").body))[0]
