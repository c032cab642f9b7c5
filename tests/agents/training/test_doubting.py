"""A short training tells exits and distances better than chance, in a town that it never saw; its file drives alike.

CI trains for a moment, which is enough for a file. ``-m soak`` trains until the network has learned.
"""

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

pytest.importorskip("sumo", reason="generated towns need netconvert")

from wrongturn_agents import resolve
from wrongturn_agents.models.gate import MEMORY, Gate
from wrongturn_agents.training.doubting import run
from wrongturn_agents.training.doubting.config import POLICIES, DoubtingConfig
from wrongturn_agents.training.doubting.exporting import GatedDoubt, export_doubting
from wrongturn_agents.training.doubting.run import BEST, is_doubting, load_doubt, train
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.export import export
from wrongturn_sim import WrongturnVectorEnv

PICTURES, EXAMINED = 256, 128
ENOUGH_PICTURES, ENOUGH_EXAMINED = 5_120, 1_024
OPTIONS = ("batch_size=64", "learning_rate=2e-3", "warm_up=10", "average=0.95", "generated=1", "augment=false")


def trained(folder: Path, pictures: int, examined: int) -> Path:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "examine", partial(run.examine, pictures=examined))
        return train(
            "doubting-segmentation",
            directory=folder / "run",
            towns=folder / "towns",
            seed=1,
            pictures=pictures,
            device="cpu",
            options=OPTIONS,
        )


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trained(tmp_path_factory.mktemp("doubting"), PICTURES, EXAMINED)


@pytest.fixture(scope="module")
def whole(checkpoint: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All its parts in one file, of half precision."""
    file = tmp_path_factory.mktemp("whole") / "whole.onnx"
    export_doubting(checkpoint, file, "fp16")
    return file


@pytest.mark.soak
def test_a_short_training_beats_chance_in_towns_never_seen(tmp_path: Path) -> None:
    _, found = load_doubt(trained(tmp_path, ENOUGH_PICTURES, ENOUGH_EXAMINED))
    told = found["told"]["towns never seen"]
    # Always telling the most frequent exits is right for about two exits in three, and for one place in three.
    assert told["exits"] > 0.8
    assert told["approaches"] > 0.5
    assert told["distance"] < 6.0
    assert found["pictures"] == ENOUGH_PICTURES


@pytest.mark.slow
@pytest.mark.parametrize("precision", [pytest.param("fp32", marks=pytest.mark.soak), "fp16"])
def test_the_file_drives_as_the_parts_do(checkpoint: Path, whole: Path, precision: str, tmp_path: Path) -> None:
    """One car drives a whole trial with the file; each step is repeated by network, gate and driving agent."""
    file = whole
    if precision != "fp16":
        file = tmp_path / "doubting.onnx"
        export_doubting(checkpoint, file, precision)
    agent = resolve(str(file)).make()
    doubt, _ = load_doubt(checkpoint)
    parts, driving = GatedDoubt(doubt, Gate()).eval(), resolve(POLICIES["doubting-segmentation"]).make()
    memory, commands = torch.zeros(1, MEMORY), set()
    for seed in (1, 3):
        envs = WrongturnVectorEnv(
            1, "Town01", "segmentation", fault="infeasible", autoreset_mode=AutoresetMode.DISABLED, record=False
        )
        observation, _ = envs.reset(seed=seed)
        agent.reset(envs.single_observation_space)
        memory = torch.zeros(1, MEMORY)
        ended = False
        while not ended:
            one = {name: array[0] for name, array in observation.items()}
            with torch.inference_mode():
                tensors = {name: torch.from_numpy(array) for name, array in observation.items()}
                command, memory = parts(tensors, memory)
            commands.add(int(command.item()))
            wanted = driving.act({**one, "command": command.numpy()[0]})
            action = agent.act(one)
            tolerance = 1e-4 if precision == "fp32" else 0.02
            actions, others = (np.array([[one.steer, one.throttle, one.brake]], np.float32) for one in (action, wanted))
            assert np.allclose(actions, others, atol=tolerance)
            observation, _, terminated, truncated, _ = envs.step(actions)
            ended = bool(terminated[0] or truncated[0])
        envs.close()
    assert len(commands) > 1


@pytest.mark.slow
def test_the_parts_that_are_shipped_drive_as_the_whole_file(
    checkpoint: Path, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    export_doubting(checkpoint, tmp_path / "doubting-segmentation.gate.onnx", "fp16", whole=False)
    monkeypatch.setattr("wrongturn_agents.doubting_agent.WEIGHTS", tmp_path)
    source, in_one = resolve("doubting-segmentation"), resolve(str(whole))
    assert source.trained_on_faults
    assert in_one.trained_on_faults
    assert (source.name, source.track) == (in_one.name, in_one.track)
    one, other, beside = source.make(), in_one.make(), source.make()
    envs = WrongturnVectorEnv(1, "Town01", "segmentation", fault="omission", record=False)
    observation, _ = envs.reset(seed=2)
    for agent in (one, other, beside):
        agent.reset(envs.single_observation_space)
    first = {name: array[0] for name, array in observation.items()}
    for _ in range(60):
        seen = {name: array[0] for name, array in observation.items()}
        action = one.act(seen)
        assert action == other.act(seen)
        observation, *_ = envs.step(np.array([[action.steer, action.throttle, action.brake]], np.float32))
    envs.close()
    # Copies share the loaded files and not the memory.
    fresh = source.make()
    fresh.reset(envs.single_observation_space)
    assert beside.act(first) == fresh.act(first)


@pytest.mark.slow
def test_a_checkpoint_is_known_as_what_it_is(checkpoint: Path, tmp_path: Path) -> None:
    assert is_doubting(checkpoint)
    assert not is_doubting(tmp_path / "nothing.pt")
    with pytest.raises(TrainingError, match="has a run already"):
        train("doubting-segmentation", directory=checkpoint.parent, pictures=1)
    with pytest.raises(TrainingError, match="checkpoint"):
        export(checkpoint, tmp_path / "agent.onnx")
    with pytest.raises(TrainingError, match="--precision: int8"):
        export_doubting(checkpoint, tmp_path / "agent.onnx", "int8")


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("towns=3", "give name=value with one of"),
        ("generated", "give name=value with one of"),
        ("generated=many", "give a whole number"),
        ("augment=yes", "give true or false"),
        ("first_share=2", "give a number from 0 to 1"),
        ("batch_size=0", "option batch_size: is 0"),
    ],
)
def test_a_wrong_option_is_named(option: str, message: str) -> None:
    with pytest.raises(TrainingError, match=message):
        DoubtingConfig().with_options([option])


def test_a_wrong_argument_makes_no_directory(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="algorithm"):
        train("doubt", directory=tmp_path / "run")
    with pytest.raises(TrainingError, match="device"):
        train("doubting", directory=tmp_path / "run", device="tpu")
    with pytest.raises(TrainingError, match="option"):
        train("doubting", directory=tmp_path / "run", options=["x=1"])
    assert not (tmp_path / "run").exists()
    assert not (tmp_path / BEST).exists()
