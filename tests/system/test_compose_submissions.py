"""Models that are handed in to the containers of compose, and a class of somebody else beside them.

It needs a Docker engine and takes minutes, so it runs only where one answers: ``pytest -m soak tests/system``.
"""

import ast
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from system_compose_project import ROOT, Service, entries, inspect

MODEL = ROOT / "agents/wrongturn_agents/weights/ppo-segmentation.onnx"
pytestmark = [pytest.mark.soak, pytest.mark.system, pytest.mark.timeout(1800)]


MODEL_PAGE, _, CLASS_PAGE = (ROOT / "docs/submitting.md").read_text("utf-8").partition("\n## Run a class of your own")


def blocks(page: str) -> list[str]:
    return re.findall(r"```sh\n(.*?)```", page, re.DOTALL)


def bash(script: str, folder: Path, **environment: str) -> str:
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, f"{script}\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}"
    return done.stdout


def submission(composed: Service, folder: Path) -> dict[str, Any]:
    token = json.loads((folder / "owner.json").read_text())["token"]
    name = json.loads((folder / "submission.json").read_text())["id"]
    reply = composed.call("GET", f"/v1/submissions/{name}", token=token)
    assert reply.status == 200, reply.body
    return json.loads(reply.body)


def wait_for(composed: Service, folder: Path, reached: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    deadline = time.monotonic() + 300
    while not reached(now := submission(composed, folder)):
        assert time.monotonic() < deadline, now
        time.sleep(0.2)
    return now


def test_a_model_handed_in_by_curl_is_ranked(composed: Service, tmp_path: Path) -> None:
    """The page's blocks, from outside, as they stand."""
    shutil.copy(MODEL, tmp_path / "my_agent.onnx")
    serve, *shown = blocks(MODEL_PAGE)
    assert serve == "wrongturn serve\n"
    bash("".join(shown).replace("http://127.0.0.1:8000", f"http://127.0.0.1:{composed.port}"), tmp_path)
    done = submission(composed, tmp_path)
    assert done["state"] == "finished", done
    (entry,) = [entry for entry in entries(composed) if entry["evaluation"] == done["evaluation"]]
    assert (entry["entry"], entry["agent"]["owner"], entry["agent"]["track"]) == (
        "uploaded",
        "our group",
        "segmentation",
    )
    assert entry["rank"] is not None


TRIES = """
import os, pathlib, socket

def tries(call, *arguments):
    try:
        call(*arguments)
    except OSError:
        return False
    return True

"""
LOOK_ROUND = (
    TRIES
    + """writable = [folder for folder, _, _ in os.walk("/") if not folder.startswith(("/proc", "/sys")) and
            tries(pathlib.Path(folder, "written").write_bytes, b"x")]
for folder in writable:
    pathlib.Path(folder, "written").unlink()
print({
    "user": os.getuid(),
    "interfaces": os.listdir("/sys/class/net"),
    "names": tries(socket.getaddrinfo, "service", 8000),
    "secrets": os.path.exists("/run/secrets"),
    "settings": [name for name in os.environ if "TOKEN" in name or "PASSWORD" in name or "DATABASE" in name],
    "writable": writable,
    "fits": tries(pathlib.Path("/run/wrongturn/large").write_bytes, bytes(1 << 20)),
    "capabilities": [line.split()[1] for line in open("/proc/self/status") if line.startswith("Cap")],
})
pathlib.Path("/run/wrongturn/large").unlink(missing_ok=True)
"""
)


def test_the_runner_has_no_network_no_secrets_and_writes_nothing(composed: Service) -> None:
    found = ast.literal_eval(composed.compose("exec", "-T", "runner", "python", "-c", LOOK_ROUND))
    assert found == {
        "user": 10002,
        "interfaces": ["lo"],
        "names": False,
        "secrets": False,
        "settings": [],
        "writable": ["/run/wrongturn"],
        "fits": False,
        "capabilities": ["0000000000000000"] * 5,
    }
    runner = composed.compose("ps", "-q", "runner").strip()
    assert inspect(runner, "{{.HostConfig.NetworkMode}} {{.HostConfig.ReadonlyRootfs}}") == "none true"
    limits = inspect(runner, "{{.HostConfig.Memory}} {{.HostConfig.PidsLimit}} {{.HostConfig.NanoCpus}}").split()
    assert all(int(limit) > 0 for limit in limits), limits
    assert composed.compose("exec", "-T", "service", "ls", "/run/wrongturn").split() == ["runner.sock"]
    write = ["exec", "-T", "service", "sh", "-c", "touch /run/wrongturn/written"]
    with pytest.raises(AssertionError, match="Read-only file system"):
        composed.compose(*write)


def test_nothing_reaches_the_host_but_one_port_and_the_secrets(composed: Service) -> None:
    published = {}
    for container in composed.compose("ps", "-q").split():
        name = inspect(container, '{{index .Config.Labels "com.docker.compose.service"}}')
        published[name] = json.loads(inspect(container, "{{json .HostConfig.PortBindings}}")) or {}
        for mount in json.loads(inspect(container, "{{json .Mounts}}")):
            assert mount["Type"] in {"volume", "tmpfs"} or Path(mount["Source"]).parent == composed.secrets, mount
    assert published.pop("service") == {"8000/tcp": [{"HostIp": "127.0.0.1", "HostPort": str(composed.port)}]}
    assert not any(published.values()), published
    assert published.keys() == {"database", "runner"}


def test_a_runner_that_is_killed_takes_no_submission_with_it(composed: Service, tmp_path: Path) -> None:
    shutil.copy(MODEL, tmp_path / "my_agent.onnx")
    _, owner, hand_in, *_ = blocks(MODEL_PAGE)
    begin = (owner + hand_in).replace("http://127.0.0.1:8000", f"http://127.0.0.1:{composed.port}")
    bash(begin.replace("our group", "unlucky group").replace("my-agent", "my-unlucky-agent"), tmp_path)
    wait_for(composed, tmp_path, lambda now: (now.get("finished") or 0) > 0)
    runner = composed.compose("ps", "-q", "runner").strip()
    before = int(inspect(runner, "{{.RestartCount}}"))
    # From outside: the engine does not start a container again that 'docker kill' ended.
    os.kill(int(inspect(runner, "{{.State.Pid}}")), signal.SIGKILL)
    assert submission(composed, tmp_path)["state"] == "running"
    done = wait_for(composed, tmp_path, lambda now: now["state"] not in {"queued", "checked", "running"})
    assert (done["state"], done["finished"]) == ("finished", 12), done
    assert int(inspect(runner, "{{.RestartCount}}")) == before + 1
    results = {entry["evaluation"]: entry for entry in entries(composed)}
    assert results[done["evaluation"]]["aborted"] == 0


LOOK_OUT = (
    TRIES
    + """print({
    "secrets": os.listdir("/run/secrets"),
    "tokens": [name for name in os.environ if "TOKEN" in name],
    "reaches": {name: tries(socket.getaddrinfo, name, 80) for name in ("service", "database", "example.org")},
    "writes": tries(pathlib.Path("/agent/written").write_bytes, b"x"),
})
"""
)


def test_a_class_of_somebody_else_runs_with_its_owners_token(composed: Service, tmp_path: Path) -> None:
    """The page's blocks, but for the build of the image, which is there."""
    register_owner, drive = blocks(CLASS_PAGE)
    bash(
        register_owner.replace("http://127.0.0.1:8000", f"http://127.0.0.1:{composed.port}").replace("our", "their"),
        tmp_path,
    )
    composed.environment["WRONGTURN_OWNER_TOKEN_FILE"] = str(tmp_path / "owner" / "token")
    (command,) = [line for line in drive.splitlines() if line.startswith("docker compose")]
    _, arguments = command.split(" run --rm ")
    shown = composed.compose("run", "--rm", "-T", *shlex.split(arguments))
    assert "Not ranked" in shown
    (entry,) = [entry for entry in entries(composed) if entry["agent"]["name"] == "slow one"]
    assert (entry["entry"], entry["agent"]["owner"]) == ("remote", "their group")
    found = ast.literal_eval(composed.compose("run", "--rm", "-T", "--entrypoint", "python", "agent", "-c", LOOK_OUT))
    assert found == {
        "secrets": ["owner_token"],
        "tokens": ["WRONGTURN_OWNER_TOKEN_FILE"],
        "reaches": {"service": True, "database": False, "example.org": False},
        "writes": False,
    }
