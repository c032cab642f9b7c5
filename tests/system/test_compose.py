"""The compose file as a user would try it: up, agents driven from outside and as workers, a leaderboard, down, up again
with everything still there.

It needs a Docker engine and takes minutes, so it runs only where one answers: ``pytest -m soak tests/system``.
"""

import json
import os
import subprocess
import sys
import time

import pytest
from system_compose_project import Service, entries, first_trial, inspect, register

pytestmark = [pytest.mark.soak, pytest.mark.system, pytest.mark.timeout(1800)]


def test_it_is_healthy_and_not_root(composed: Service) -> None:
    deadline = time.monotonic() + 60
    while (state := inspect(composed.container(), "{{.State.Health.Status}}")) != "healthy":
        assert time.monotonic() < deadline, state
        time.sleep(1)
    assert composed.compose("exec", "-T", "service", "id", "-u").strip() == "10001"
    for name in ("service", "database"):
        container = composed.compose("ps", "-q", name).strip()
        assert composed.compose("exec", "-T", name, "id", "-u").strip() != "0"
        assert inspect(container, "{{.HostConfig.ReadonlyRootfs}}") == "true"
        # No secret stands where 'docker inspect' shows it.
        for file in composed.secrets.iterdir():
            assert file.read_text() not in inspect(container, "{{json .Config}}")


def test_the_database_wants_its_password(composed: Service) -> None:
    ask = ["exec", "-T", "-e", "PGPASSWORD=wrong", "database", "psql", "-h", "127.0.0.1", "-U", "wrongturn", "-c"]
    with pytest.raises(AssertionError, match="password authentication failed"):
        composed.compose(*ask, "SELECT 1")


def test_agents_from_outside_and_as_workers_come_on_the_leaderboard(composed: Service) -> None:
    url = f"http://127.0.0.1:{composed.port}"
    run = [sys.executable, "-m", "wrongturn_client", "run", "always-stops", "--name", "from outside"]
    program = [*run, "--url", url, "--suite", "smoke@3"]
    environment = {name: value for name, value in os.environ.items() if not name.startswith("WRONGTURN_")}
    done = subprocess.run(program, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    composed.compose("run", "--rm", "-T", "register", "careful")
    composed.compose("--profile", "careful", "up", "--no-recreate", "careful")
    found = {entry["agent"]["name"]: entry["agent"]["kind"] for entry in entries(composed)}
    assert {"from outside": "submitted", "careful": "baseline"}.items() <= found.items()
    # As README shows it; the suite of a run elsewhere is named.
    shown = composed.compose("exec", "-T", "service", "wrongturn", "leaderboard")
    assert "wrongturn leaderboard smoke@3" in shown
    assert "careful" in composed.compose("exec", "-T", "service", "wrongturn", "leaderboard", "smoke@3")


def test_no_container_compiles_what_the_image_brings_along(composed: Service) -> None:
    """After the drives above, and one that looks through the camera; a processor may need other code off x86-64."""
    token = register(composed, "looks", "camera")["token"]
    practice = {"suite": "smoke@3", "trial": first_trial(composed), "track": "camera"}
    assert composed.call("POST", "/v1/episodes", practice, token).status == 201
    compare = 'diff -r "$WRONGTURN_KERNELS" "$WRONGTURN_HOME"/numba-*'
    assert composed.compose("exec", "-T", "service", "sh", "-c", compare) == ""


def test_what_was_written_is_there_after_down_and_up(composed: Service) -> None:
    agent = register(composed, "stays")
    created = composed.call("POST", "/v1/evaluations", {"suite": "smoke@3"}, agent["token"])
    assert created.status == 201, created.body
    evaluation = json.loads(created.body)
    before = entries(composed)
    composed.compose("--profile", "careful", "down")
    assert composed.call("GET", "/health/live").status == 0
    composed.up()
    found = composed.call("GET", f"/v1/evaluations/{evaluation['id']}", token=agent["token"])
    assert found.status == 200, found.body
    assert json.loads(found.body)["suite"] == "smoke@3"
    taken = composed.call("POST", "/v1/agents", {"name": "stays", "track": "privileged"})
    assert taken.status == 409, taken.body
    assert entries(composed) == before
