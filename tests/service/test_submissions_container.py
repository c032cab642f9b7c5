"""The sandboxes are behind a socket, as in compose: they come later, they are few, and they are lost in between."""

import contextlib
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest
from service_harness import RunningService, expect, problem
from small_models import steady
from submission_owner import Owner, until

# CI has tests/sandbox/test_listener.py for the program, and test_submissions_dispatch.py for sandboxes that are lost.
pytestmark = pytest.mark.soak


@contextlib.contextmanager
def container(path: Path, most: int) -> Iterator[subprocess.Popen[bytes]]:
    """The program of the runner container."""
    command = [sys.executable, "-m", "wrongturn_sandbox", "--listen", str(path), "--most", str(most)]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            until(path.exists, 60)
            yield process
        finally:
            process.kill()


def hand_in(owner: Owner) -> str:
    """Hand a model in as soon as the service takes it."""
    deadline = time.monotonic() + 120
    while True:
        response = owner.post(steady(), "steady")
        if response.status_code != 503 or time.monotonic() > deadline:
            return str(expect(response, 202)["id"])
        time.sleep(0.5)


def test_a_container_comes_late_is_lost_and_comes_back(tmp_path: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="wt") as short:  # a socket's path has at most 107 characters
        path = Path(short) / "runner.sock"
        service = RunningService(tmp_path / "a.db", simulators=4, submissions=1, runner_socket=path)
        owner = Owner(service.url)
        try:
            refused = problem(owner.post(steady(), "steady"), 503, "submissions-unavailable")
            assert str(path) in refused["detail"]
            with container(path, 2):
                submission = hand_in(owner)
                ready = expect(httpx.get(f"{service.url}/health/ready", timeout=60), 200)
                assert ready["submissions"].startswith("on: runner container")
                until(lambda: owner.get(submission).get("finished", 0) >= 1, 600)
            assert owner.get(submission)["state"] == "running"
            # One sandbox is enough, though a drive takes two where it can.
            with container(path, 1):
                found = owner.until(submission, "finished", seconds=600)
            assert found["finished"] == found["episodes"]
            assert any("lost" in line for line in owner.log(submission))
        finally:
            owner.close()
            status = service.stop()
        assert status == 0
        assert '"level": "error"' not in service.stderr, service.stderr
