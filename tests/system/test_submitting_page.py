"""The page on handing in works as it stands: by command, and by curl alone."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from onnx import TensorProto, helper

from wrongturn_client import Client, LocalService

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/submitting.md").read_text("utf-8").partition("\n## The sandbox")[0]
MODEL = ROOT / "agents/wrongturn_agents/weights/ppo-segmentation.onnx"
SERVED_AT = "http://127.0.0.1:8000"
pytestmark = [pytest.mark.system, pytest.mark.timeout(600), pytest.mark.usefixtures("bubblewrap")]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalService]:
    database = tmp_path_factory.mktemp("service") / "wrongturn.db"
    with LocalService(database=f"sqlite+aiosqlite:///{database}") as service:
        yield service


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copy(MODEL, tmp_path / "my_agent.onnx")
    return tmp_path


def environment(**more: str) -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if not name.startswith("WRONGTURN_")} | more


def test_curl_leads_from_a_fresh_service_to_a_rank(service: LocalService, folder: Path) -> None:
    serve, *blocks = re.findall(r"```sh\n(.*?)```", PAGE, re.DOTALL)
    assert serve == "wrongturn serve\n"
    marked = "echo; echo ----\n".join(blocks)
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", marked.replace(SERVED_AT, service.url)],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    owner, submission, state, log, board, cancelled = map(json.loads, done.stdout.split("\n----\n"))
    assert owner["name"] == "our group"
    assert (folder / "owner.json").stat().st_mode & 0o077 == 0
    assert (submission["state"], submission["size"]) == ("queued", MODEL.stat().st_size)
    assert (state["state"], state["track"], state["finished"]) == ("finished", "segmentation", 12)
    assert len(log["lines"]) >= 3
    (entry,) = [entry for entry in board["entries"] if entry["evaluation"] == state["evaluation"]]
    assert (entry["entry"], entry["agent"]["owner"]) == ("uploaded", "our group")
    # A service draws anew each time. In some draws the model misses one of the six twins, and a rank needs all of them.
    assert entry["rank"] == (1 if entry["twins"]["completed"] == 6 else None), entry["why_not"]
    assert cancelled == state
    with Client(service.url) as client:
        # What the file's metadata says.
        assert "segmentation" in (client.agent(state["agent"]).description or "")


def test_a_broken_model_says_what_is_wrong_and_frees_its_name(service: LocalService, folder: Path) -> None:
    """Its inputs and outputs keep the contract, so only the service finds the operator that it forbids."""
    steer = helper.make_tensor_value_info("steer", TensorProto.FLOAT, ["N", 1])
    accelerate = helper.make_tensor_value_info("accelerate", TensorProto.FLOAT, ["N", 1])
    speed = helper.make_tensor_value_info("speed", TensorProto.FLOAT, ["N", 1])
    nodes = [helper.make_node("RandomUniformLike", ["speed"], [put.name]) for put in (steer, accelerate)]
    graph = helper.make_graph(nodes, "graph", [speed], [steer, accelerate])
    broken = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(broken, {"track": "camera"})
    (folder / "broken.onnx").write_bytes(broken.SerializeToString())
    home = environment(WRONGTURN_HOME=str(folder / "home"))
    command = [sys.executable, "-m", "wrongturn_client", "submit", "broken.onnx", "--suite", "smoke@3"]
    for _ in range(2):
        done = subprocess.run(
            [*command, "--url", service.url], cwd=folder, env=home, capture_output=True, text=True, check=False
        )
        assert done.returncode == 1, done.stderr
        assert done.stdout.startswith("broken failed: ")
        assert "random numbers are not allowed" in done.stdout
        assert "Traceback" not in done.stderr


def test_every_state_and_option_is_explained() -> None:
    from wrongturn_protocol import SubmissionState

    assert re.findall(r"^\| `(\w+)` \| ", PAGE, re.MULTILINE) == [state.value for state in SubmissionState]
