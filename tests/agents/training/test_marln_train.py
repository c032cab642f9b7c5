import csv
import json

import numpy as np
import onnx
import pytest
import torch
from small_marln import OPTIONS, small_marln  # noqa: F401 - a fixture

from wrongturn_agents.models.marln import ACTIONS, Marln, ValueNetwork
from wrongturn_agents.onnx_agent import OnnxAgent
from wrongturn_agents.training.checkpoint import load_checkpoint
from wrongturn_agents.training.config import config_of
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.quantisation import quantise
from wrongturn_agents.training.marln import run
from wrongturn_agents.training.marln.exporting import KEYS, export_marln
from wrongturn_agents.training.marln.learning import Learner
from wrongturn_agents.training.marln.network import marln_of
from wrongturn_agents.training.marln.replay import Decisions, Replay, Sample
from wrongturn_agents.training.memory import memory_named
from wrongturn_agents.training.train import train


def test_a_run_its_files_and_its_continuation(tmp_path, small_marln):  # noqa: F811
    folder = tmp_path / "run"
    rows = []
    best = train("marln", directory=folder, seed=3, steps=64, device="cpu", threads=1, options=OPTIONS)
    assert best == folder / "best.pt"
    found = load_checkpoint(best)
    assert (found["algorithm"], found["seed"], found["steps"]) == ("marln", 3, 64)
    assert json.loads((folder / "pretraining.json").read_text("utf-8"))["minibatches"] == 2
    before = {name: tensor.clone() for name, tensor in marln_of(found).state_dict().items()}
    train("marln", directory=folder, steps=96, device="cpu", threads=1, resume=True, on_row=rows.append)
    assert rows[-1]["step"] == 96
    after = marln_of(load_checkpoint(folder / "last.pt")).state_dict()
    assert not torch.equal(after["values.projection.1.weight"], before["values.projection.1.weight"])
    assert torch.equal(
        after["network.stem.embedder.convolution.weight"], before["network.stem.embedder.convolution.weight"]
    )
    with (folder / "progress.csv").open(encoding="utf-8") as file:
        assert [int(row["step"]) for row in csv.DictReader(file)] == [64, 96]
    exported = tmp_path / "marln.onnx"
    export_marln(folder / "last.pt", exported, "fp16")
    _drives_as(marln_of(load_checkpoint(folder / "last.pt")), OnnxAgent(exported))


def test_a_run_interrupted_after_its_pretraining_keeps_its_encoder(tmp_path, monkeypatch, small_marln):  # noqa: F811
    def interrupt(*_):
        raise KeyboardInterrupt

    folder = tmp_path / "run"
    with monkeypatch.context() as patched:
        patched.setattr(run, "Cars", interrupt)
        with pytest.raises(KeyboardInterrupt):
            train("marln", directory=folder, seed=3, steps=8, device="cpu", threads=1, options=OPTIONS)
    encoder = torch.load(folder / "encoder.pt", weights_only=True)
    with pytest.raises(TrainingError, match="--resume"):
        train("marln", directory=folder, steps=8, device="cpu", options=OPTIONS)
    rows, pretrained = [], []
    train(
        "marln", directory=folder, device="cpu", threads=1, resume=True, on_row=rows.append,
        on_pretraining=lambda *told: pretrained.append(told),
    )  # fmt: skip
    assert not pretrained
    assert rows[-1]["step"] == 8
    assert 60.0 * rows[-1]["minutes"] > encoder["seconds"] > 0.0
    weights = load_checkpoint(folder / "last.pt")["state_dict"]
    assert all(torch.equal(weights[name], tensor) for name, tensor in encoder["state_dict"].items())


def _drives_as(model: Marln, agent: OnnxAgent) -> None:
    """The file remembers as the network does. Halved weights may tip a choice between two actions now and then."""
    assert agent.track == "camera"
    assert not agent.memoryless
    random = np.random.default_rng(1)
    memory, same = model.begin(1), 0
    for _ in range(12):
        shown = {
            "speed": random.uniform(0, 10, (1,)).astype(np.float32),
            "steering": random.uniform(-1, 1, (1,)).astype(np.float32),
            "command": random.integers(1, 5, (1,)),
            "rgb": random.integers(0, 256, (64, 192, 3), np.uint8),
        }
        assert set(shown) == set(KEYS)
        with torch.inference_mode():
            batch = {key: torch.from_numpy(array[None]) for key, array in shown.items()}
            wanted, memory = model.drive_on(batch, memory)
        action = agent.act(shown)
        same += np.allclose((action.steer, action.throttle, action.brake), wanted[0].numpy(), atol=1e-3)
    assert same >= 10


def test_learning_finds_the_better_action():
    """A bandit of one decision: action 7 pays 1 after LEFT, action 11 after RIGHT, all others nothing."""
    torch.manual_seed(1)

    config = config_of("marln").with_options(
        ["batch_size=32", "quantiles=4", "target_quantiles=4", "learning_rate=4e-3", "target_every=10"]
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

    config = config_of("marln").with_options(["hidden=8"])
    values = ValueNetwork(12, hidden=8, deviation=0.0)
    learner = Learner(values, config, torch.Generator().manual_seed(1))
    with torch.no_grad():
        for network, best, height in ((values, 5, 50.0), (learner.target, 9, 70.0)):
            network.heads.advantage.weight.zero_()
            network.heads.advantage.bias.zero_()
            network.heads.value.weight.zero_()
            network.heads.value.bias.fill_(3.0)
            network.heads.advantage.bias[..., best] = height
    rows = 2
    zeros, ones = torch.zeros(rows, 12), torch.ones(rows)
    sample = Sample(
        features=zeros, measured=torch.zeros(rows, 2), command=torch.ones(rows, dtype=torch.int64),
        action=torch.zeros(rows, dtype=torch.int64), returns=torch.tensor([1.0, 2.0]),
        following=torch.tensor([0.5, 0.0]), next_features=zeros, next_measured=torch.zeros(rows, 2),
        next_command=torch.ones(rows, dtype=torch.int64), weight=ones, places=torch.arange(rows),
    )  # fmt: skip
    actions = values.heads.advantage.outputs
    of_action_5 = 3.0 - 70.0 / actions  # the target network's, whose own best action is another
    found = learner.wanted(sample)
    assert found.shape == (rows, config.target_quantiles)
    assert found[0].tolist() == pytest.approx([1.0 + 0.5 * of_action_5] * config.target_quantiles, rel=1e-4)
    assert found[1].tolist() == pytest.approx([2.0] * config.target_quantiles)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("replay_size=100", "option replay_size: is 100"),
        ("learn_after=1", "option learn_after: is 1"),
        ("replay_ratio=0", "option replay_ratio: is 0"),
        ("priority_exponent=2", "option priority_exponent: is 2"),
        ("gamma=2", "option gamma: is 2"),
    ],
)
def test_settings_that_make_no_sense(option, said):
    with pytest.raises(TrainingError, match=said):
        config_of("marln").with_options([option])


def test_ablations_name_their_variant():
    config = config_of("marln")
    assert config.variant is None
    assert config.with_options(["pretrained=false"]).variant == "without-pretraining"
    assert config.with_options(["augment=false"]).variant == "without-augmentation"


def test_an_encoder_of_another_program(tmp_path):
    path = tmp_path / "encoder.pt"
    torch.save({"state_dict": {"other": torch.ones(1)}}, path)
    with pytest.raises(TrainingError, match="option encoder"):
        train("marln", directory=tmp_path / "run", steps=8, device="cpu", options=[f"encoder={path}"])
    assert not (tmp_path / "run").exists()


def test_a_replay_memory_that_is_too_large_is_named(tmp_path):
    with pytest.raises(TrainingError, match="option replay_size: 1000000000 decisions need"):
        train("marln", directory=tmp_path / "run", steps=8, device="cpu", options=["replay_size=1000000000"])
    assert not (tmp_path / "run").exists()


def test_on_a_gpu_its_own_free_memory_decides(monkeypatch):
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _: (2**30, 2**40))
    config = config_of("marln").with_options(["replay_size=400000", "num_envs=4"])
    with pytest.raises(TrainingError, match="400000 decisions need 5 GiB, and there are 1"):
        memory_named(config, torch.device("cuda")).__enter__()


def test_a_run_of_ppo_is_not_marlns(tmp_path):
    told = {"algorithm": "ppo-image", "config": config_of("ppo-image").as_dict(), "state_dict": {}}
    with pytest.raises(TrainingError, match="not of marln"):
        marln_of(told)


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
