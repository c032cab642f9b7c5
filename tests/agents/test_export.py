"""A checkpoint in torch and its ONNX file drive alike; the networks are untrained, their last layer made loud."""

import copy
import re
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

from wrongturn_agents import resolve  # noqa: E402
from wrongturn_agents.models import build  # noqa: E402
from wrongturn_agents.training.checkpoint import save_checkpoint  # noqa: E402
from wrongturn_agents.training.errors import TrainingError  # noqa: E402
from wrongturn_agents.training.export.export import agreement, export, sha256  # noqa: E402
from wrongturn_agents.training.export.writing import OPSET, export_graph  # noqa: E402
from wrongturn_agents.training.method import find_method, load  # noqa: E402
from wrongturn_agents.training.recording import record_observations  # noqa: E402
from wrongturn_protocol import Track  # noqa: E402


@pytest.fixture(scope="module")
def observations():
    return record_observations("segmentation", 200, seed=7)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    folder = tmp_path_factory.mktemp("checkpoints")

    def make(algorithm: str) -> Path:
        path = folder / f"{algorithm}.pt"
        if not path.exists():
            model = build(algorithm, seed=0)
            with torch.no_grad():
                model.branches.policy.weight.mul_(100.0)  # else all actions are about 0
            settings = find_method(algorithm).settings()
            save_checkpoint(path, model, settings, seed=3, steps=1000, evaluation={"success": 0.5})
        return path

    return make


@pytest.fixture(scope="module")
def exported(checkpoint, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exported")
    calibration = record_observations("segmentation", 60, seed=8)
    graphs = {}

    def make(algorithm: str, precision: str) -> Path:
        path = folder / f"{algorithm}.{precision}.onnx"

        def once(*arguments):
            """The graph is the same for each precision, and takes the most time."""
            if algorithm not in graphs:
                graphs[algorithm] = export_graph(*arguments)
            return copy.deepcopy(graphs[algorithm])

        if not path.exists():
            seen = calibration if precision == "int8" else None
            with patch(f"{export.__module__}.export_graph", once):
                export(checkpoint(algorithm), path, precision, observations=seen)
        return path

    return make


@pytest.mark.parametrize(
    ("algorithm", "precision", "mean", "greatest"),
    [
        ("ppo-segmentation", "fp32", 1e-5, 1e-4),
        pytest.param("ppo-image", "fp32", 1e-5, 1e-4, marks=pytest.mark.soak),
        pytest.param("ppo-auxiliary", "fp32", 1e-5, 1e-4, marks=pytest.mark.soak),
        ("ppo-segmentation", "fp16", 1e-3, 5e-3),
        pytest.param("ppo-segmentation", "int8", 0.02, 0.1),
        pytest.param("ppo-image", "int8", 0.05, 0.2, marks=pytest.mark.soak),
    ],
)
def test_its_actions_are_the_checkpoints(checkpoint, exported, observations, algorithm, precision, mean, greatest):
    compared = {key: array[:50] for key, array in observations.items()}
    found = agreement(load(checkpoint(algorithm)), exported(algorithm, precision), compared)
    print(algorithm, precision, found)
    assert found.observations == 50
    assert max(found.mean) <= mean
    assert max(found.greatest) <= greatest


def test_the_untrained_agent_does_not_always_do_the_same(exported, observations):
    """Otherwise equal actions would say nothing."""
    agent = resolve(str(exported("ppo-segmentation", "fp32"))).make()
    steers = [agent.act({key: array[i] for key, array in observations.items()}).steer for i in range(50)]
    assert np.std(steers) > 0.05


def test_the_file_tells_what_it_is(exported):
    file = exported("ppo-segmentation", "fp32")
    source = resolve(str(file))
    assert (source.name, source.track) == ("ppo-segmentation", Track.SEGMENTATION)
    model = onnx.load(file)
    told = {entry.key: entry.value for entry in model.metadata_props}
    said = [told[name] for name in ("algorithm", "seed", "steps", "precision")]
    assert said == ["ppo-segmentation", "3", "1000", "fp32"]
    assert [put.name for put in model.graph.input] == ["speed", "steering", "command", "segmentation"]
    assert [put.name for put in model.graph.output] == ["action"]
    assert {(item.domain, item.version) for item in model.opset_import} == {("", OPSET)}


def test_the_file_holds_nothing_of_the_machine_it_was_made_on(exported):
    content = exported("ppo-segmentation", "fp32").read_bytes()
    assert str(Path(__file__).parents[2]).encode() not in content
    assert not re.search(rb"[\w/]+\.py\b", content)


@pytest.mark.soak
def test_neither_decoder_nor_value_is_in_it(exported):
    """ResNet-34 (21.3 M weights), the wide layer (3.1 M) and the policy's heads, no more: 4 bytes each."""
    assert exported("ppo-image", "fp32").stat().st_size < 99.5e6


def test_the_same_checkpoint_gives_the_same_file(checkpoint, exported, tmp_path):
    again = tmp_path / "again.onnx"
    export(checkpoint("ppo-segmentation"), again, "fp16")
    assert sha256(again) == sha256(exported("ppo-segmentation", "fp16"))
    whole = exported("ppo-segmentation", "fp32").stat().st_size
    assert again.stat().st_size == pytest.approx(whole / 2, rel=0.02)


def test_observations_are_the_same_for_the_same_seed(observations):
    again = record_observations("segmentation", 40, seed=7)
    assert all(np.array_equal(again[key], observations[key][:40]) for key in again)
    assert set(np.unique(observations["command"])) >= {1, 2, 3, 4}


def test_what_cannot_be_exported_is_told(tmp_path, checkpoint):
    with pytest.raises(TrainingError, match="there is no such file"):
        export(tmp_path / "missing.pt", tmp_path / "a.onnx")
    with pytest.raises(TrainingError, match=r"FILE: .*name a file in a directory that exists"):
        export(checkpoint("ppo-segmentation"), tmp_path / "no" / "a.onnx")
    with pytest.raises(ValueError, match="number: is 0"):
        record_observations("segmentation", 0)
