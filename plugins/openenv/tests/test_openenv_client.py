"""OpenEnv's own client against ``wrongturn openenv`` before a real service."""

import asyncio
import importlib
import importlib.util
import json
import signal
import subprocess
import sys
import venv
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import httpx
import pytest

from wrongturn_client import LocalService
from wrongturn_openenv.server import READY
from wrongturn_protocol import Track, Verdict
from wrongturn_protocol.observations import decode, observation_space

pytestmark = pytest.mark.skipif(importlib.util.find_spec("openenv") is None, reason="openenv-core is not installed")
TRAINER = """
import sys
from openenv.core import GenericEnvClient
with GenericEnvClient(base_url=sys.argv[1]).sync() as env:
    result = env.reset(seed=7, town="Town02", fault="omission")
    while not result.done:
        result = env.step({"steer": 0.0, "throttle": 1.0, "brake": 0.0})
    print(env.state()["verdict"])
"""
GAS = {"steer": 0.0, "throttle": 1.0, "brake": 0.0}


@pytest.fixture(scope="module")
def openenv() -> ModuleType:
    """The module of ``GenericEnvClient``, without OpenEnv's server, which imports many packages that we do not have."""
    spec = importlib.util.find_spec("openenv")
    assert spec is not None
    (folder,) = spec.submodule_search_locations or ()
    core = ModuleType("openenv.core")
    core.__path__ = [str(Path(folder, "core"))]
    sys.modules["openenv.core"] = core
    return importlib.import_module("openenv.core.generic_client")


@pytest.fixture(scope="module")
def server(service: LocalService) -> Iterator[str]:
    command = [sys.executable, "-m", "wrongturn_client", "openenv", "--url", service.url, "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        line = process.stdout.readline()
        assert line.startswith(READY), process.stderr.read()
        yield line.removeprefix(READY).strip()
        process.send_signal(signal.SIGTERM)
        assert process.wait(120) == 0, process.stderr.read()
        assert process.stderr.read() == ""


def test_an_episode_from_reset_to_its_verdict(openenv: ModuleType, server: str) -> None:
    with openenv.GenericEnvClient(base_url=server).sync() as env:
        result = env.reset(seed=7, track="camera", fault="infeasible")
        rewards = []
        while not result.done:
            assert observation_space(Track.CAMERA).contains(decode(result.observation, Track.CAMERA))
            result = env.step(GAS)
            rewards.append(result.reward)
        state = env.state()
        assert state["step_count"] == len(rewards) > 5
        assert state["terminated"]
        assert state["verdict"] in set(Verdict)
        assert len(set(rewards)) > 1
        with pytest.raises(RuntimeError, match="call reset"):
            env.step(GAS)
        again = env.reset(seed=7)
        assert env.state()["episode_id"] != state["episode_id"]
        assert not again.done


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_all_of_openenv_core_accepts_the_server(server: str, tmp_path: Path) -> None:
    """The same client as a trainer gets it, with all that pip installs for it, and OpenEnv's validator."""
    venv.create(tmp_path, with_pip=True)
    subprocess.run([tmp_path / "bin/pip", "install", "-q", "openenv-core==0.3.0"], check=True)
    drive = [tmp_path / "bin/python", "-c", TRAINER, server]
    said = subprocess.run(drive, check=True, capture_output=True, text=True).stdout
    assert said.strip() in set(Verdict)
    validate = [tmp_path / "bin/openenv", "validate", server]
    report = subprocess.run(validate, check=True, capture_output=True, text=True).stdout
    assert json.loads(report)["passed"], report


def test_a_client_of_mcp_drives_an_episode_by_tools(openenv: ModuleType, server: str) -> None:
    stub = ModuleType("openenv.core.env_server")
    stub.__path__ = [str(Path(sys.modules["openenv.core"].__path__[0], "env_server"))]
    sys.modules.setdefault("openenv.core.env_server", stub)
    client = importlib.import_module("openenv.core.mcp_client").MCPToolClient

    async def drive() -> dict[str, Any]:
        env = client(base_url=server)
        env.use_production_mode = True  # else it sends its calls as steps over /ws
        assert [tool.name for tool in await env.list_tools()] == ["begin_episode", "drive", "look_up"]
        begun = await env.call_tool("begin_episode", seed=7, town="Town02", fault="omission")
        assert begun["structuredContent"]["observation"]["speed"] > 0
        done = False
        while not done:
            done = (await env.call_tool("drive", **GAS))["structuredContent"]["done"]
        told = (await env.call_tool("look_up"))["structuredContent"]
        with pytest.raises(RuntimeError, match=r"there is no tool 'fly'; there are begin_episode, drive, look_up"):
            await env.call_tool("fly")
        await env.close()
        return told

    assert asyncio.run(drive())["verdict"] is not None


def test_plain_mcp_over_http(server: str) -> None:
    def call(method: str, **params: Any) -> dict[str, Any]:
        body = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
        answer = httpx.post(f"{server}/mcp", json=body, timeout=60).json()
        assert (answer["jsonrpc"], answer["id"]) == ("2.0", 1)
        return answer

    assert call("initialize", protocolVersion="2025-06-18")["result"]["capabilities"] == {"tools": {}}
    ready = {"jsonrpc": "2.0", "method": "notifications/initialized"}
    assert httpx.post(f"{server}/mcp", json=ready, timeout=60).status_code == 202
    early = call(
        "tools/call", name="drive", arguments=GAS, session_id=call("openenv/session/create")["result"]["session_id"]
    )
    assert early["result"]["isError"]
    assert "call reset" in early["result"]["content"][0]["text"]
    refused = call("tools/call", name="drive", arguments={"steer": 2})["error"]
    assert (refused["code"], "steer" in refused["message"]) == (-32602, True)
    assert call("tools/call", name="begin_episode", arguments={"town": "nowhere"})["result"]["isError"]
    assert call("fly")["error"]["code"] == -32601
    assert httpx.post(f"{server}/mcp", content="{", timeout=60).json()["error"]["code"] == -32600
