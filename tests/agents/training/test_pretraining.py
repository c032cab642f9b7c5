"""What an encoder learns from before it drives, and what happens to it."""

import json

import pytest
import torch
from small_run import HERE, SMALL, settings_of

from wrongturn_agents.training.checkpoint import load_checkpoint
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.method import find_method
from wrongturn_agents.training.methods.pretraining import WanderingCars
from wrongturn_agents.training.run import train
from wrongturn_protocol import SegmentationClass

ROAD_USERS = {SegmentationClass.VEHICLE, SegmentationClass.PEDESTRIAN}
OPTIONS = (*SMALL, "traffic=0", "pretraining_frames=16", "pretraining_batch=4", "pretraining_passes=1")

pytestmark = pytest.mark.usefixtures("small_networks")


@pytest.mark.parametrize(("traffic", "wanted"), [(0.7, ROAD_USERS), (0.0, set())])
def test_the_encoder_sees_those_whom_its_policy_will_meet(traffic, wanted):
    config = settings_of("ppo-image", "num_envs=48", f"traffic={traffic}")
    cars = WanderingCars(config, torch.device("cpu"), seed=1, threads=1)
    seen = set(cars.step()["segmentation"].unique().tolist())
    cars.envs.close()
    assert SegmentationClass.ROAD in seen
    assert seen & ROAD_USERS == wanted


def test_older_runs_keep_the_projection_that_they_were_trained_with():
    method = find_method("ppo-image")
    now = method.settings().as_dict()
    before = method.settings.of({name: value for name, value in now.items() if name != "projection"})
    assert (now["projection"], before.projection) == ("elu", "relu")
    ends = [method.build(config, "ppo-image").encoder.projection for config in (method.settings(), before)]
    assert [[type(layer).__name__ for layer in layers[2:]] for layers in ends] == [["LayerNorm", "ELU"], ["ReLU"]]


def test_an_encoder_is_pretrained_once_and_taken_by_others(tmp_path, monkeypatch):
    """The first run is interrupted after its pretraining, and goes on."""

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    first, second = tmp_path / "first", tmp_path / "second"
    with monkeypatch.context() as patched:
        patched.setattr("wrongturn_agents.training.methods.ppo.ppo.WrongturnPPO.learn", interrupt)
        with pytest.raises(KeyboardInterrupt):
            train("ppo-image", directory=first, steps=12, options=OPTIONS, **HERE)
    used = torch.load(first / "state.pt", weights_only=True)["seconds"]
    with pytest.raises(TrainingError, match="--resume"):
        train("ppo-image", directory=first, steps=12, options=OPTIONS, **HERE)
    rows, notes = [], []
    train("ppo-image", directory=first, resume=True, on_row=rows.append, on_note=notes.append, **HERE)
    assert not notes
    assert rows[-1]["step"] == 12
    assert 60.0 * rows[-1]["minutes"] > used > 0.0
    told = json.loads((first / "pretraining.json").read_text())
    assert (told["frames"], told["minibatches"]) == (16, 4)
    assert 0.0 < told["loss"] < 10.0

    train("ppo-image", directory=second, seed=2, steps=12, options=[*OPTIONS, f"encoder={first}/encoder.pt"], **HERE)
    encoder = torch.load(first / "encoder.pt", weights_only=True)["state_dict"]
    ours, theirs = (load_checkpoint(directory / "last.pt")["state_dict"] for directory in (first, second))
    for weights in (ours, theirs):
        assert all(torch.equal(weights[f"encoder.{name}"], tensor) for name, tensor in encoder.items())
    assert not torch.equal(ours["encoder.projection.1.weight"], theirs["encoder.projection.1.weight"])
