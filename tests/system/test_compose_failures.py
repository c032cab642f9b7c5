"""The containers when a disk is full or memory runs out: readiness, log and recovery, as docs/compose.md says.

It needs a Docker engine and the right to mount disks, and takes minutes: ``pytest -m soak tests/system``.
"""

import contextlib
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from system_compose_project import Service, inspect

pytestmark = [pytest.mark.soak, pytest.mark.system, pytest.mark.timeout(1800)]

DISKS = {"database": 280, "wal": 120, "data": 120}
"""Size of each volume in MB."""
USERS = {"database": "database", "wal": "database", "data": "service"}
"""Whose container writes to each volume."""
WAL = "/var/lib/postgresql/wal"
MODEL = Path(__file__).parents[2] / "agents/wrongturn_agents/weights/ppo-segmentation.onnx"


def command(*words: str) -> str:
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{words}: {done.stderr}"
    return done.stdout.strip()


@pytest.fixture(scope="module")
def small(composed: Service, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """The containers on small disks. The database's write-ahead log has one of its own."""
    if os.geteuid() != 0:
        pytest.skip("only root can mount disks")
    folder = tmp_path_factory.mktemp("disks")
    lines = ["services: {database: {volumes: ['wal:" + WAL + "']}}", "volumes:"]
    users = {name: composed.compose("exec", "-T", service, "id", "-u").strip() for name, service in USERS.items()}
    with contextlib.ExitStack() as mounted:
        for name, size in DISKS.items():
            command("truncate", "-s", f"{size}M", str(folder / f"{name}.disk"))
            command("mkfs.ext4", "-q", "-m", "0", str(folder / f"{name}.disk"))
            disk = folder / name
            disk.mkdir()
            command("mount", "-o", "loop", str(folder / f"{name}.disk"), str(disk))
            mounted.callback(command, "umount", str(disk))
            (disk / "volume").mkdir(mode=0o700)
            os.chown(disk / "volume", int(users[name]), 0)
            lines.append(f"  {name}: {{driver_opts: {{type: none, o: bind, device: '{disk}/volume'}}}}")
        override = folder / "small.yaml"
        override.write_text("\n".join(lines))
        project = Service(composed.secrets, override)
        project.settings = folder / "service.env"
        # More simulators than the memory is enough for.
        project.settings.write_text("WRONGTURN_SIMULATORS=16\n")
        project.environment |= {"WRONGTURN_ENV_FILE": str(project.settings), "WRONGTURN_SERVICE_MEMORY": "900m"}
        project.disks = folder  # type: ignore[attr-defined]
        mounted.callback(project.compose, "down", "--volumes")
        project.compose("up", "-d", "database")
        database = project.compose("ps", "-q", "database").strip()
        wait_until(lambda: inspect(database, "{{.State.Health.Status}}") == "healthy")
        project.compose("stop", "database")
        move = f"mv $PGDATA/pg_wal {WAL}/pg_wal && ln -s {WAL}/pg_wal $PGDATA/pg_wal"
        project.compose("run", "--rm", "-T", "--entrypoint", "sh", "database", "-c", move)
        project.up()
        yield project


def wait_until(true: Callable[[], bool], limit_s: float = 120) -> None:
    deadline = time.monotonic() + limit_s
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.5)


@contextlib.contextmanager
def full(small: Service, name: str) -> Iterator[None]:
    """Fill a disk to its last byte for a while."""
    filler = small.disks / name / "filler"  # type: ignore[attr-defined]
    with filler.open("wb", buffering=0) as opened, contextlib.suppress(OSError):
        while opened.write(bytes(1 << 16)):
            pass
    try:
        yield
    finally:
        filler.unlink()


def ready(small: Service) -> SimpleNamespace:
    return small.call("GET", "/health/ready")


def register(small: Service) -> SimpleNamespace:
    """Register an agent with a text that no page of the database has room for at last."""
    registration = {"name": f"x {time.monotonic_ns()}", "track": "privileged", "description": os.urandom(240).hex()}
    return small.call("POST", "/v1/agents", registration, (small.secrets / "operator_token").read_text())


def logged(small: Service) -> list[str]:
    """Events of the service's log."""
    lines = small.compose("logs", "--no-color", "service").splitlines()
    return [json.loads(line[line.index("{") :])["event"] for line in lines if "{" in line]


def assert_it_recovers(small: Service) -> None:
    """The service is ready again by itself, without a restart of its own, and says so."""
    wait_until(lambda: ready(small).status == 200)
    assert register(small).status == 201
    assert inspect(small.container(), "{{.RestartCount}}") == "0"
    assert logged(small).count("the database fails") > 0
    assert [event for event in logged(small) if event.startswith("the database")][-1] == "the database works again"


def test_the_databases_disk_is_full(small: Service) -> None:
    with full(small, "database"):
        refused = next(reply for _ in range(1000) if (reply := register(small)).status != 201)
        assert refused.status == 503, refused.body
        assert json.loads(refused.body)["type"] == "/problems/storage-failed"
        wait_until(lambda: b"its disk is full" in ready(small).body)
        assert ready(small).status == 503
    assert_it_recovers(small)


def test_the_disk_of_the_write_ahead_log_is_full(small: Service) -> None:
    """PostgreSQL itself stops then, and compose starts it again until there is room."""
    switch = "CREATE TABLE filler AS SELECT repeat(md5(i::text), 99) FROM generate_series(1, 2000) i"
    with full(small, "wal"):
        for query in ("SELECT pg_switch_wal()", switch, "SELECT pg_switch_wal()", "SELECT 1"):
            with contextlib.suppress(AssertionError):
                small.compose("exec", "-T", "database", "psql", "-U", "wrongturn", "-c", query)
        wait_until(lambda: ready(small).status == 503)
        assert register(small).status == 503
    assert_it_recovers(small)


def test_the_disk_of_the_services_home_is_full(small: Service, tmp_path: Path) -> None:
    """Driving goes on; only models are refused."""
    owner = small.call("POST", "/v1/owners", {"name": "full"}, (small.secrets / "operator_token").read_text())
    token = json.loads(owner.body)["token"]
    wait_until(lambda: b"on: runner container" in ready(small).body)
    url = f"http://127.0.0.1:{small.port}/v1/submissions"
    form = ["-F", "suite=smoke@3", "-F", "name=too late", "-F", f"model=@{MODEL}"]
    send = ["curl", "-sS", "-H", f"Authorization: Bearer {token}", *form, url]
    with full(small, "data"):
        reply = json.loads(command(*send))
        assert (reply["status"], reply["type"]) == (507, "/problems/storage-failed"), reply
        assert ready(small).status == 200
        (agents,) = drive(small, tmp_path, 1)
        assert agents == 0
    assert json.loads(command(*send))["state"] == "queued"


def drive(small: Service, home: Path, agents: int) -> list[int]:
    """Let agents drive at the same time; return the status of each."""
    url = f"http://127.0.0.1:{small.port}"
    program = [sys.executable, "-m", "wrongturn_client", "run", "always-stops", "--suite", "smoke@3", "--url", url]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("WRONGTURN_")}
    workers = [
        subprocess.Popen(
            [*program, "--name", f"driver {time.monotonic_ns()}"],
            env={**environment, "WRONGTURN_HOME": str(home)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for _ in range(agents)
    ]
    return [worker.wait(timeout=600) for worker in workers]


def test_memory_runs_out(small: Service, tmp_path: Path) -> None:
    """The kernel ends simulators; their episodes go on in others, and the service stays."""
    assert drive(small, tmp_path, 8) == [0] * 8
    assert "simulator died" in logged(small)
    assert ready(small).status == 200
    assert inspect(small.container(), "{{.RestartCount}}") == "0"
