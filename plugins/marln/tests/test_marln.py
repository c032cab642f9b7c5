"""A training of seconds drives better than chance; it resumes, and its file drives as it does."""

import json
import shutil

import numpy as np
import onnx
import pytest
import torch
from metres_driven import CARS, alike, by_chance, metres
from small_run import HERE, settings_of

from wrongturn_agents.onnx_agent import OnnxAgent
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.export import export
from wrongturn_agents.training.export.writing import quantise
from wrongturn_agents.training.method import load
from wrongturn_agents.training.progress import read_rows
from wrongturn_agents.training.recording import record_observations
from wrongturn_agents.training.run import train
from wrongturn_marln.learning import Learner
from wrongturn_marln.network import ACTIONS, ValueNetwork
from wrongturn_marln.replay import Decisions, Replay, Sample

OPTIONS = (
    *("num_envs=16", "batch_size=32", "replay_ratio=4", "replay_size=8000", "learn_after=256", "hidden=16"),
    *("quantiles=4", "target_quantiles=4", "target_every=20", "n_step=3", "noise=0.3"),
    *("learning_rate=1.5e-3", "projection_learning_rate=1", "augment=false"),
    *("pretraining_frames=256", "pretraining_batch=32", "pretraining_passes=1"),
    # So few steps suffice for a short horizon, and for what is learned first: not to leave the road.
    *("gamma=0.9", "reward_divisor=30", "failure_penalty=2", "standing_penalty=2", "standing_cost=0"),
    *("time_limit=8", "inside_junctions=0", "traffic=0", "journeys=1", "brief_journeys=1", "patience=1"),
    *("sceneries=1", "groups=2"),
)
STEPS = 288
ENOUGH = 2048
"""Steps after which it drives better than chance."""


@pytest.fixture(scope="module")
def run(tmp_path_factory, small_marln):
    folder = tmp_path_factory.mktemp("marln")
    best = train("marln", directory=folder, seed=1, steps=STEPS, options=OPTIONS, **HERE)
    assert best == folder / "best.pt"
    return folder


@pytest.mark.soak
def test_a_short_training_beats_a_random_policy(tmp_path, small_marln):
    train("marln", directory=tmp_path, seed=1, steps=ENOUGH, options=OPTIONS, **HERE)
    model = load(tmp_path / "last.pt").model
    # By chance 7.7 and 15.1 m, standing 1.6 m, untrained 3.8 m. This training came to 25.1 m, another seed to 19.2 m.
    chance = max(metres(by_chance()), metres(by_chance(torch.tensor(ACTIONS))))
    assert metres(model.drive_on, model.begin(CARS), pictures=True) > 1.2 * chance


def test_a_pretraining_without_time_says_so(tmp_path, small_marln):
    options = [*OPTIONS, "pretraining_frames=1000000", "pretraining_minutes=1e-9"]
    with pytest.raises(TrainingError, match="no time for a minibatch; give more --minutes"):
        train("marln", directory=tmp_path, seed=1, steps=STEPS, options=options, **HERE)
    assert not (tmp_path / "encoder.pt").exists()


def test_a_run_goes_on_and_its_file_drives_alike(run, tmp_path):
    folder, more = tmp_path / "run", STEPS + 320
    shutil.copytree(run, folder)
    found = load(folder / "last.pt")
    assert (found.agent.name, found.told["seed"], found.told["steps"]) == ("marln", 1, STEPS)
    assert json.loads((folder / "pretraining.json").read_text("utf-8"))["minibatches"] == 8
    rows = []
    train("marln", directory=folder, steps=more, resume=True, on_row=rows.append, **HERE)
    assert rows[-1]["step"] == more
    before, after = found.model.state_dict(), load(folder / "last.pt").model.state_dict()
    assert not torch.equal(after["values.projection.1.weight"], before["values.projection.1.weight"])
    assert torch.equal(
        after["network.stem.embedder.convolution.weight"], before["network.stem.embedder.convolution.weight"]
    )
    steps = [int(row["step"]) for row in read_rows(folder / "progress.csv")]
    assert steps == sorted(steps)
    assert {STEPS, more} <= set(steps)
    exported = tmp_path / "marln.onnx"
    export(folder / "last.pt", exported, "fp16")
    agent = OnnxAgent(exported)
    assert (agent.track, agent.memoryless) == ("camera", False)
    shown = record_observations("camera", 12, seed=1)
    # Halved weights may tip a choice between two actions now and then.
    assert alike(load(folder / "last.pt").model, agent, shown, 1e-3) >= 10


def test_learning_finds_the_better_action():
    """A bandit of one decision: action 7 pays 1 after LEFT, action 11 after RIGHT, all others nothing."""
    torch.manual_seed(1)

    config = settings_of(
        "marln", "batch_size=32", "quantiles=4", "target_quantiles=4", "learning_rate=4e-3", "target_every=10"
    )
    generator = torch.Generator().manual_seed(1)
    values = ValueNetwork(12, hidden=16)
    learner = Learner(values, config, generator)
    replay = Replay(6400, 64, 12, n_step=1, gamma=0.9, exponent=0.2, dtype=torch.float32)
    paid = torch.tensor([7, 11])
    for _ in range(60):
        command = torch.randint(1, 3, (64,), generator=generator)
        action = torch.randint(len(ACTIONS), (64,), generator=generator)
        action = torch.where(torch.rand(64, generator=generator) < 0.3, paid[command - 1], action)
        ended = torch.ones(64, dtype=torch.bool)
        reward = (action == paid[command - 1]).float()
        features, measured = torch.randn(64, 12, generator=generator), torch.zeros(64, 2)
        replay.add(Decisions(features, measured, command, action, reward, ended, ~ended))
    for step in range(100):
        learner.update(replay, step / 100)
    features, measured = torch.randn(40, 12), torch.zeros(40, 2)
    for number, command in ((7, 1), (11, 2)):
        chosen = values.choose(features, measured, torch.full((40,), command))
        assert (chosen == number).float().mean() > 0.9


def test_the_target_is_the_double_one():
    """The network chooses the action that follows, and the target network values it; nothing follows an end."""
    torch.manual_seed(1)

    config = settings_of("marln", "hidden=8")
    values = ValueNetwork(12, hidden=8, deviation=0.0)
    learner = Learner(values, config, torch.Generator().manual_seed(1))
    with torch.no_grad():
        for network, best, height in ((values, 5, 50.0), (learner.target, 9, 70.0)):
            network.heads.advantage.weight.zero_()
            network.heads.advantage.bias.zero_()
            network.heads.value.weight.zero_()
            network.heads.value.bias.fill_(3.0)
            network.heads.advantage.bias[..., best] = height
    zeros = torch.zeros(2, 12)
    decisions = Decisions(zeros, zeros[:, :2], *(torch.tensor([1, 1]), torch.tensor([0, 0]), *zeros[:, :3].T))
    sample = Sample(
        now=decisions, returns=torch.tensor([1.0, 2.0]), following=torch.tensor([0.5, 0.0]), later=decisions,
        weight=torch.ones(2), places=torch.arange(2),
    )  # fmt: skip
    actions = values.heads.advantage.outputs
    of_action_5 = 3.0 - 70.0 / actions  # the target network's, whose own best action is another
    found = learner.wanted(sample)
    assert found.shape == (2, config.target_quantiles)
    assert found[0].tolist() == pytest.approx([1.0 + 0.5 * of_action_5] * config.target_quantiles, rel=1e-4)
    assert found[1].tolist() == pytest.approx([2.0] * config.target_quantiles)


def test_heads_side_by_side_stay_as_they_are_in_8_bits():
    """onnxruntime has no product of several matrices in 8 bits: a file with one could not run."""
    weights = np.zeros((4, 600, 500), np.float32)
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("MatMul", ["seen", "heads"], ["told"], name="heads")],
        "side by side",
        [onnx.helper.make_tensor_value_info("seen", onnx.TensorProto.FLOAT, ("n", 1, 600))],
        [onnx.helper.make_tensor_value_info("told", onnx.TensorProto.FLOAT, (4, 1, 500))],
        [onnx.numpy_helper.from_array(weights, "heads")],
    )
    conv = onnx.helper.make_node("Conv", ["picture", "filters"], ["found"], name="convolution")
    graph.node.append(conv)
    graph.input.append(onnx.helper.make_tensor_value_info("picture", onnx.TensorProto.FLOAT, (1, 16, 4, 4)))
    graph.output.append(onnx.helper.make_tensor_value_info("found", onnx.TensorProto.FLOAT, (1, 16, 2, 2)))
    graph.initializer.append(onnx.numpy_helper.from_array(np.ones((16, 16, 3, 3), np.float32), "filters"))
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=8)
    small = quantise(model, {"seen": np.ones((1, 1, 600), np.float32), "picture": np.ones((1, 16, 4, 4), np.float32)})
    kinds = {tensor.name: tensor.data_type for tensor in small.graph.initializer}
    assert kinds["heads"] == onnx.TensorProto.FLOAT
    assert "filters" not in kinds
