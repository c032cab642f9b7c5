"""A short training tells exits and distances better than chance, in a town that it never saw; its file drives alike.

The shorter run trains for a moment in the towns that are shipped, which is enough for a file. ``-m soak`` trains in
generated ones until the network has learned.
"""

import dataclasses
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_run import HERE

pytest.importorskip("onnxruntime")

from wrongturn_agents import resolve
from wrongturn_agents.models.gate import MEMORY, Gate
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS, SHIPPED_AGENTS
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.export import export
from wrongturn_agents.training.method import load
from wrongturn_agents.training.methods.doubting import frames, method
from wrongturn_agents.training.methods.doubting.exporting import GatedDoubt, write_doubting
from wrongturn_agents.training.progress import read_rows
from wrongturn_agents.training.run import train
from wrongturn_agents.training.score import score, score_agent
from wrongturn_networks import load_suite, load_town
from wrongturn_sim import WrongturnSimEnv

PICTURES, ENOUGH = 256, 5_120
OPTIONS = ("batch_size=64", "learning_rate=2e-3", "warm_up=10", "average=0.95", "augment=false")
NAME = "doubting-segmentation"


def trained(folder: Path, pictures: int, *options: str, name: str = NAME, **more: Any) -> Path:
    """Train for a moment: it is examined on few pictures, and a shipped town stands for those never seen."""
    with pytest.MonkeyPatch.context() as patch:
        for told in ("examine", "temperatures"):
            patch.setattr(method, told, partial(getattr(frames, told), pictures=128))
        patch.setattr(method, "towns_of", lambda *_: [load_town("junctions")])
        return train(name, directory=folder, steps=pictures, options=options, **HERE, **more)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return trained(tmp_path_factory.mktemp("doubting") / "run", PICTURES, *OPTIONS, "generated=0", seed=1)


@pytest.mark.soak
def test_a_short_training_beats_chance_in_towns_never_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(method, "HELD_OUT", method.HELD_OUT[:1])
    train(NAME, directory=tmp_path, seed=1, steps=ENOUGH, options=(*OPTIONS, "generated=1"), **HERE)
    found = load(tmp_path / "best.pt").told
    told = found["evaluation"]["towns never seen"]
    # Always telling the most frequent exits is right for about two exits in three, and for one place in three.
    assert told["exits"] > 0.8
    assert told["approaches"] > 0.5
    assert told["distance"] < 6.0
    assert found["steps"] == ENOUGH


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=() if one == NAME else pytest.mark.soak) for one in DOUBTING_AGENTS]
)
def test_the_file_drives_as_the_parts_do(
    checkpoint: Path, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One car drives whole trials with one file. The two files that are shipped, and torch, repeat each step."""
    if name != NAME:
        checkpoint = trained(tmp_path / "run", 64, *OPTIONS, "generated=0", name=name, seed=1)
    whole, drives = tmp_path / "whole.onnx", DOUBTING_AGENTS[name].drives
    export(checkpoint, whole, "fp16")
    write_doubting(load(checkpoint), tmp_path / f"{name}.gate.onnx", "fp16", whole=False)
    (tmp_path / f"{drives}.onnx").symlink_to(SHIPPED_AGENTS[drives].file)
    monkeypatch.setattr("wrongturn_agents.shipped_agents.WEIGHTS", tmp_path)
    source, in_one = resolve(name), resolve(str(whole))
    assert all(one.trained_on_faults for one in (source, in_one))
    assert (source.name, source.track) == (in_one.name, in_one.track)
    agent, shipped, beside = in_one.make(), source.make(), source.make()
    told = load(checkpoint).told["evaluation"]["temperatures"]
    parts = GatedDoubt(load(checkpoint).model, Gate(), (told["exits"], told["line"])).eval()
    driving = resolve(drives).make()
    commands = set()
    for fault, seed in (("infeasible", 1), ("infeasible", 3), ("steering_gain", 1)):
        env = WrongturnSimEnv("Town01", source.track, fault=fault)
        first, info = env.reset(seed=seed)
        for one in (agent, shipped, beside, driving):
            one.reset(env.observation_space)
        memory, seen = torch.zeros(1, MEMORY), first
        while "verdict" not in info:
            with torch.inference_mode():
                tensors = {name: torch.from_numpy(array[None].copy()) for name, array in seen.items()}
                command, memory, doubt = parts(tensors, memory)
            commands.add(int(command.item()))
            wanted = driving.act({**seen, "command": command.numpy()[0]})
            action = agent.act(seen)
            assert action == shipped.act(seen)
            assert agent.doubt == shipped.doubt == pytest.approx(doubt.item(), abs=0.02)
            both = [np.array([one.steer, one.throttle, one.brake]) for one in (action, wanted)]
            assert np.allclose(*both, atol=0.02) or fault == "steering_gain"
            seen, *_, info = env.step(action)
    assert len(commands) > 1
    # Copies share the loaded files and not the memory.
    fresh = source.make()
    fresh.reset(env.observation_space)
    assert beside.act(first) == fresh.act(first)


def test_a_run_goes_on_and_its_checkpoint_is_known_as_what_it_is(checkpoint: Path, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="doubting-segmentation does not drive by itself; export it"):
        score(checkpoint, "smoke@3", device="cpu")
    with pytest.raises(TrainingError, match="--precision: int8"):
        export(checkpoint, tmp_path / "agent.onnx", "int8")
    trained(checkpoint.parent, PICTURES + 128, resume=True)
    assert load(checkpoint).told["steps"] == PICTURES + 128
    steps = [
        int(row["step"]) for row in read_rows(checkpoint.parent / "progress.csv")
    ]  # there are more if it took long
    assert steps == sorted(steps)
    assert {PICTURES, PICTURES + 128} <= {*steps}


def test_the_shipped_one_overrides_what_the_road_does_not_offer(monkeypatch: pytest.MonkeyPatch) -> None:
    """A trial of the open draw for each fault, which the twins go with."""
    suite = load_suite("smoke@3")
    few = tuple({trial.fault.kind: trial for trial in suite.trials}.values())
    few_alone = dataclasses.replace(suite, cells=(), listed=few)
    monkeypatch.setattr("wrongturn_agents.training.score.load_suite", lambda _: few_alone)
    driven = score_agent(NAME, suite.id, threads=1)["trials"]
    assert len(driven) == 4
    found = [driven[trial.id] for trial in few]
    assert {one["verdict"] for one in found} <= {"exit_route", "exit_other"}
    assert {one["reaction"] for one in found} <= {"overrode", "exit"}
