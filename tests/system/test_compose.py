"""The compose file as a user would try it: up, agents driven from outside and as workers, a leaderboard, down, up again
with everything still there, and a backup that can be put back.

It needs a Docker engine and takes minutes, so it runs only where one answers: ``pytest -m soak tests/system``.
"""

import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
import uuid
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = [pytest.mark.soak, pytest.mark.system, pytest.mark.timeout(1800)]


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

    def __init__(self, secrets: Path) -> None:
        self.port = free_port()
        self.secrets = secrets
        self.environment = {
            **os.environ,
            "WRONGTURN_PORT": str(self.port),
            "WRONGTURN_SECRETS": str(secrets),
            "WRONGTURN_SUITE": "smoke@2",
        }
        project = f"wrongturntest{uuid.uuid4().hex[:8]}"
        self.command = [*compose_program(), "-p", project, "-f", str(ROOT / "docker" / "compose.yaml")]

    def compose(self, *arguments: str) -> str:
        done = subprocess.run(
            [*self.command, *arguments], env=self.environment, cwd=ROOT, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{arguments}: {done.stdout[-3000:]}\n{done.stderr[-3000:]}"
        return done.stdout

    def up(self) -> None:
        self.compose("up", "-d")
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


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    secrets = tmp_path_factory.mktemp("compose") / "secrets"
    subprocess.run([str(ROOT / "docker" / "make-secrets"), str(secrets)], check=True, capture_output=True)
    project = Service(secrets)
    try:
        project.compose("--profile", "careful", "build")
        project.up()
        yield project
    finally:
        project.compose("--profile", "careful", "down", "--volumes")


def test_it_is_healthy_and_not_root(service: Service) -> None:
    deadline = time.monotonic() + 60
    while (state := inspect(service.container(), "{{.State.Health.Status}}")) != "healthy":
        assert time.monotonic() < deadline, state
        time.sleep(1)
    assert service.compose("exec", "-T", "service", "id", "-u").strip() == "10001"
    for name in ("service", "database"):
        container = service.compose("ps", "-q", name).strip()
        assert service.compose("exec", "-T", name, "id", "-u").strip() != "0"
        assert inspect(container, "{{.HostConfig.ReadonlyRootfs}}") == "true"
        # No secret stands where 'docker inspect' shows it.
        for file in service.secrets.iterdir():
            assert file.read_text() not in inspect(container, "{{json .Config}}")


def test_it_leaves_no_volume_without_a_name_behind(service: Service) -> None:
    project = service.command[service.command.index("-p") + 1]
    for name in ("service", "database"):
        mounts = json.loads(inspect(service.compose("ps", "-q", name).strip(), "{{json .Mounts}}"))
        volumes = [mount["Name"] for mount in mounts if mount["Type"] == "volume"]
        assert volumes
        assert all(volume.startswith(f"{project}_") for volume in volumes), volumes


def test_the_database_wants_its_password(service: Service) -> None:
    ask = [
        "exec",
        "-T",
        "-e",
        "PGPASSWORD=wrong",
        "database",
        "psql",
        "-h",
        "127.0.0.1",
        "-U",
        "wrongturn",
        "-c",
        "SELECT 1",
    ]
    with pytest.raises(AssertionError, match="password authentication failed"):
        service.compose(*ask)


def test_it_lists_suites_and_towns(service: Service) -> None:
    suites = json.loads(service.call("GET", "/v1/suites").body)
    assert {"wrong-command@2", "smoke@2"} <= set(ids_in(suites))
    assert service.call("GET", "/v1/towns/Town01").status == 200


def test_it_drives_a_practice_episode(service: Service) -> None:
    token = register(service, "driver")["token"]
    practice = {"suite": "smoke@2", "trial": first_trial(service), "track": "privileged"}
    reset = service.call("POST", "/v1/episodes", practice, token)
    assert reset.status == 201, reset.body
    action = {"seq": 1, "action": {"steer": 0, "throttle": 0, "brake": 1}}
    step = service.call("POST", f"/v1/episodes/{json.loads(reset.body)['id']}/step", action, token)
    assert step.status == 200, step.body
    assert json.loads(step.body)["seq"] == 1


def test_only_the_operators_token_registers_a_baseline(service: Service) -> None:
    wanted = {"name": "shipped", "track": "privileged", "kind": "baseline"}
    for token in (None, "another-token"):
        assert service.call("POST", "/v1/agents", wanted, token).status in {401, 403}
    token = (service.secrets / "operator_token").read_text()
    assert service.call("POST", "/v1/agents", wanted, token).status == 201


def entries(service: Service) -> list[dict[str, Any]]:
    board = service.call("GET", "/v1/leaderboards/smoke@2")
    assert board.status == 200, board.body
    return json.loads(board.body)["entries"]


def test_agents_from_outside_and_as_workers_come_on_the_leaderboard(service: Service) -> None:
    url = f"http://127.0.0.1:{service.port}"
    program = [sys.executable, "-m", "wrongturn_client", "run", "always-stops", "--url", url, "--suite", "smoke@2"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("WRONGTURN_")}
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    service.compose("--profile", "careful", "up", "--no-recreate", "careful")
    found = {entry["agent"]["name"]: entry["agent"]["kind"] for entry in entries(service)}
    assert found == {"always-stops": "submitted", "careful": "baseline"}
    # As README shows it; the suite of a run elsewhere is named.
    shown = service.compose("exec", "-T", "service", "wrongturn", "leaderboard")
    assert "wrongturn leaderboard smoke@2" in shown
    assert "careful" in service.compose("exec", "-T", "service", "wrongturn", "leaderboard", "smoke@2")


def test_no_container_compiles_what_the_image_brings_along(service: Service) -> None:
    """After the drives above, and one that looks through the camera; a processor may need other code off x86-64."""
    token = register(service, "looks", "camera")["token"]
    practice = {"suite": "smoke@2", "trial": first_trial(service), "track": "camera"}
    assert service.call("POST", "/v1/episodes", practice, token).status == 201
    compare = 'diff -r "$WRONGTURN_KERNELS" "$WRONGTURN_HOME"/numba-*'
    assert service.compose("exec", "-T", "service", "sh", "-c", compare) == ""


def test_what_was_written_is_there_after_down_and_up(service: Service) -> None:
    agent = register(service, "stays")
    created = service.call("POST", "/v1/evaluations", {"suite": "smoke@2"}, agent["token"])
    assert created.status == 201, created.body
    evaluation = json.loads(created.body)
    before = entries(service)
    service.compose("--profile", "careful", "down")
    assert service.call("GET", "/health/live").status == 0
    service.up()
    found = service.call("GET", f"/v1/evaluations/{evaluation['id']}", token=agent["token"])
    assert found.status == 200, found.body
    assert json.loads(found.body)["suite"] == "smoke@2"
    taken = service.call("POST", "/v1/agents", {"name": "stays", "track": "privileged"})
    assert taken.status == 409, taken.body
    assert entries(service) == before


def test_a_backup_as_documented(service: Service) -> None:
    """The commands of docs/operating.md, but for their shell's redirections."""
    kept = register(service, "kept")
    dump = [*service.command, "exec", "-T", "database", "pg_dump", "-U", "wrongturn", "-Fc", "wrongturn"]
    backup = subprocess.run(dump, env=service.environment, cwd=ROOT, capture_output=True, check=True).stdout
    register(service, "gone")
    service.compose("stop", "service")
    back = ["pg_restore", "-U", "wrongturn", "-d", "wrongturn", "--clean", "--if-exists", "--single-transaction"]
    restore = [*service.command, "exec", "-T", "database", *back]
    subprocess.run(restore, env=service.environment, cwd=ROOT, input=backup, capture_output=True, check=True)
    service.up()
    names = {agent["name"] for agent in json.loads(service.call("GET", "/v1/agents").body)["agents"]}
    assert "kept" in names
    assert "gone" not in names
    assert service.call("POST", "/v1/evaluations", {"suite": "smoke@2"}, kept["token"]).status == 201


def register(service: Service, name: str, track: str = "privileged") -> dict[str, str]:
    reply = service.call("POST", "/v1/agents", {"name": name, "track": track})
    assert reply.status == 201, reply.body
    return json.loads(reply.body)


def ids_in(listing: object) -> list[str]:
    """Ids of a list, bare or under a key."""
    rows = listing if isinstance(listing, list) else next(iter(listing.values()))
    return [row["id"] for row in rows]


def first_trial(service: Service) -> str:
    return ids_in(json.loads(service.call("GET", "/v1/suites/smoke@2/trials").body))[0]
