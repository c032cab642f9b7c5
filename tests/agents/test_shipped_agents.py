"""The trained agents: listed, made from their files, and told clearly where something is missing."""

import importlib.util
import json

import numpy as np
import pytest

from wrongturn_agents import list_agents, resolve
from wrongturn_agents.errors import ModelFileError
from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.registry import AGENTS
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS, SHIPPED_AGENTS
from wrongturn_protocol import AgentKind, Track
from wrongturn_protocol.observations import observation_space

NAMES = sorted(SHIPPED_AGENTS)
PRIVILEGED = "lbc-privileged"


def test_the_trained_are_listed_as_references_after_the_baselines():
    listed = {agent.name: agent for agent in list_agents()}
    after = [name for name in listed if listed[name].kind is not AgentKind.EXPLOIT]
    trained = ["ppo-segmentation", "ppo-image", "ppo-auxiliary", "lbc", PRIVILEGED, "marln"]
    assert after == [*AGENTS, *trained, *DOUBTING_AGENTS, "lbc-words"]
    assert list(listed)[: len(after)] == after
    other = {"ppo-segmentation": Track.SEGMENTATION, PRIVILEGED: Track.PRIVILEGED}
    assert {name: listed[name].track for name in trained} == dict.fromkeys(trained, Track.CAMERA) | other
    assert {listed[name].kind for name in SHIPPED_AGENTS} == {AgentKind.REFERENCE}
    assert [listed[name].track for name in DOUBTING_AGENTS] == [Track.CAMERA, Track.SEGMENTATION]


def test_missing_weights_are_told_with_the_remedy(monkeypatch, tmp_path):
    monkeypatch.setattr("wrongturn_agents.shipped_agents.WEIGHTS", tmp_path)
    with pytest.raises(ModelFileError, match=r"ships no weights of it; train it .*export .*run ppo-image\.onnx"):
        resolve("ppo-image").make()
    with pytest.raises(ModelFileError, match=r"train lbc --seed 1'.* runs/lbc-1/privileged\.pt lbc-privileged\.onnx"):
        resolve(PRIVILEGED).make()
    with pytest.raises(ModelFileError, match=r"ships no weights of it; train it .*train doubting --seed 1"):
        resolve("doubting").make()


def test_agents_without_weights_are_listed_as_such(monkeypatch, tmp_path):
    monkeypatch.setattr("wrongturn_agents.shipped_agents.WEIGHTS", tmp_path)
    (tmp_path / "ppo-segmentation.onnx").write_text("some")
    said = {agent.name: agent.description for agent in list_agents()}
    assert "train ppo-image'" in said["ppo-image"]
    assert "train lbc'" in said[PRIVILEGED]
    assert "No weights" not in said["ppo-segmentation"]


@pytest.mark.parametrize(("name", "file"), [("ppo-image", "ppo-image.onnx"), ("doubting", "doubting.gate.onnx")])
def test_broken_weights_are_told_with_the_remedy(monkeypatch, tmp_path, name, file):
    pytest.importorskip("onnxruntime")
    monkeypatch.setattr("wrongturn_agents.shipped_agents.WEIGHTS", tmp_path)
    (tmp_path / file).write_text("not a model")
    with pytest.raises(ModelFileError, match=f"weights of {name} are broken; install wrongturn-agents again"):
        resolve(name).make()


@pytest.mark.skipif(importlib.util.find_spec("onnxruntime") is None, reason="onnxruntime is not installed")
@pytest.mark.parametrize("name", [*NAMES, *DOUBTING_AGENTS])
def test_the_weights_are_that_agent(name):
    source = resolve(name)
    assert source.trained_on_faults is (name in DOUBTING_AGENTS)
    agent = source.make()
    assert (agent.name, agent.track) == (name, source.track)
    space = observation_space(source.track)
    agent.reset(space)
    space.seed(0)
    observation = space.sample()
    observation["command"] = np.array([4], np.int64)
    action = agent.act(observation)
    assert -1.0 <= action.steer <= 1.0
    assert min(action.throttle, action.brake) == 0.0
    agent.reset(space)
    assert agent.act(observation) == action


@pytest.mark.skipif(importlib.util.find_spec("onnxruntime") is None, reason="onnxruntime is not installed")
@pytest.mark.parametrize("name", NAMES)
def test_the_weights_drive_as_their_checkpoint_did(name):
    """By what the export found on 200 recorded observations, and wrote down in the file."""
    told = open_session(SHIPPED_AGENTS[name].file).get_modelmeta().custom_metadata_map
    found = json.loads(told["agreement"])
    assert found["observations"] == 200
    mean, greatest = (0.012, 0.07) if told["precision"] == "int8" else (1e-3, 5e-3)
    if name == "marln":  # it chooses one of 52 actions: where two are worth the same, the file may take the other
        mean, greatest = 0.03, 2.0
    if name in {"ppo-image", "ppo-auxiliary"}:  # a layer normalisation follows their wide 8-bit layer: 0.092 and 0.081
        greatest = 0.1
    if name == "lbc-privileged":  # its throttle depends on where its waypoints end, which rounding can move far
        greatest = 0.6
    assert max(found["mean"]) <= mean
    assert max(found["greatest"]) <= greatest


def test_the_weights_are_small_enough_for_a_package():
    # Five ResNets in 8 bits and a small network: compressed in a wheel, below the 100 MB that indexes take.
    assert sum(SHIPPED_AGENTS[name].file.stat().st_size for name in NAMES) < 115e6
