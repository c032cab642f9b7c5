"""Models as agents: what they may be, what they remember, and what is said of those that break the contract."""

import builtins
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from control_onnx import write_adder, write_concat_model, write_identity, write_model
from onnx import TensorProto, helper

from wrongturn_agents import resolve
from wrongturn_agents.errors import ModelFileError, OnnxRuntimeMissingError, RunError
from wrongturn_agents.worker import episodes_side_by_side
from wrongturn_protocol import Track
from wrongturn_protocol.model_contract import OPSETS
from wrongturn_protocol.observations import Observation, observation_space

pytest.importorskip("onnxruntime")


def observation(speed: float, steering: float) -> Observation:
    return {
        "speed": np.array([speed], np.float32),
        "steering": np.array([steering], np.float32),
        "command": np.array([4], np.int64),
    }


def test_a_model_drives(tmp_path):
    source = resolve(str(write_concat_model(tmp_path / "tiny.onnx", ("steering", "speed", "speed"))))
    assert (source.name, source.track) == ("tiny", Track.STATE)
    agent = source.make()
    agent.reset(observation_space(Track.STATE))
    action = agent.act(observation(speed=0.25, steering=-0.5))
    assert (action.steer, action.throttle, action.brake) == (-0.5, 0.25, 0.25)
    action = agent.act(observation(speed=7.0, steering=-2.0))
    assert (action.steer, action.throttle, action.brake) == (-1.0, 1.0, 1.0), "clipped"
    with pytest.raises(ModelFileError, match="must be finite"):
        agent.act(observation(float("nan"), 0.0))


def test_a_model_writes_nothing_into_the_home_folder(tmp_path):
    """onnxruntime's telemetry, which is on by default, would keep a database there."""
    model = write_concat_model(tmp_path / "tiny.onnx", ("steering", "speed", "speed"))
    home = tmp_path / "home"
    home.mkdir()
    code = "import sys; from wrongturn_agents import resolve; resolve(sys.argv[1]).make()"
    environment = {**os.environ, "HOME": str(home)}
    environment.pop("ORT_DISABLE_TELEMETRY", None)
    subprocess.run([sys.executable, "-c", code, str(model)], env=environment, check=True)
    assert not [file for file in home.rglob("*") if file.is_file()]


def test_a_model_drives_several_episodes_at_a_time(tmp_path):
    agent = resolve(str(write_concat_model(tmp_path / "tiny.onnx", ("steering", "speed", "speed")))).make()
    rows = [observation(0.25, -0.5), observation(0.5, 0.75)]
    assert agent.act_batch({key: np.stack([row[key] for row in rows]) for key in rows[0]}) == [*map(agent.act, rows)]
    assert episodes_side_by_side(agent, 3) == 3
    assert episodes_side_by_side(agent, None) == len(os.sched_getaffinity(0))
    assert episodes_side_by_side(resolve("careful").make(), None) == 1


def test_a_memory_lasts_one_episode_and_belongs_to_one_agent(tmp_path):
    source = resolve(str(write_adder(tmp_path / "adder.onnx")))
    agent, other = source.make(), source.make()
    for made in (agent, other):
        made.reset(observation_space(Track.STATE))
    assert [agent.act(observation(0.25, 0.0)).steer for _ in range(3)] == [0.25, 0.5, 0.75]
    assert other.act(observation(0.125, 0.0)).steer == 0.125
    assert agent.act(observation(0.125, 0.0)).steer == 0.875
    agent.reset(observation_space(Track.STATE))
    assert agent.act(observation(0.25, 0.0)).steer == 0.25


def test_a_model_with_a_memory_drives_one_episode_at_a_time(tmp_path):
    agent = resolve(str(write_adder(tmp_path / "adder.onnx"))).make()
    assert episodes_side_by_side(agent, None) == 1
    with pytest.raises(RunError, match="--parallel: the agent may keep a memory"):
        episodes_side_by_side(agent, 2)


@pytest.mark.parametrize("opset", OPSETS)
def test_the_installed_onnxruntime_reads_the_contracts_opsets(tmp_path, opset):
    agent = resolve(str(write_identity(tmp_path / "identity.onnx", opset))).make()
    assert agent.act(observation(speed=0.5, steering=0.125)).steer == 0.125


@pytest.mark.parametrize("opset", [OPSETS[0] - 1, OPSETS[1] + 1])
def test_an_opset_out_of_range_is_named(tmp_path, opset):
    with pytest.raises(ModelFileError, match=f"opset: {opset}; export the model with one from"):
        resolve(str(write_identity(tmp_path / "identity.onnx", opset)))


def test_metadata_names_the_agent_and_its_track(tmp_path):
    metadata = {"name": "mine", "track": "camera", "description": "A try.", "trained_on_faults": "True"}
    file = write_concat_model(tmp_path / "tiny.onnx", ("steering", "speed", "speed"), metadata=metadata)
    source = resolve(str(file))
    assert source.trained_on_faults
    assert (source.name, source.track, source.description) == ("mine", Track.CAMERA, "A try.")


@pytest.mark.parametrize(
    ("node", "says"),
    [
        (helper.make_node("Concat", ["speed", "speed"], ["action"], axis=1), r"output action: is .*float32 \(1, 2\)"),
        (helper.make_node("MatMul", ["speed", "weight"], ["action"]), "the model fails on an observation: .*MatMul"),
    ],
)
def test_a_graph_that_cannot_drive_is_told_before_anything_is_begun(tmp_path, node, says):
    """Its declared shapes are free, so only a step shows the mistake."""
    free, weight = (None, None), helper.make_tensor("weight", TensorProto.FLOAT, [2, 3], [0.0] * 6)
    file = write_model(tmp_path / "free.onnx", [node], {"speed": free}, {"action": free}, initializer=[weight])
    with pytest.raises(ModelFileError, match=says):
        resolve(str(file))


def test_without_onnxruntime(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    file = write_concat_model(tmp_path / "tiny.onnx", ("steering", "speed", "speed"))
    real_import = builtins.__import__

    def no_onnxruntime(name, *args, **kwargs):
        if name == "onnxruntime":
            raise ImportError(name)
        return real_import(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", no_onnxruntime)
    with pytest.raises(OnnxRuntimeMissingError, match=r"/python\S* -m pip install .*agents\[onnx\]"):
        resolve(str(file))
