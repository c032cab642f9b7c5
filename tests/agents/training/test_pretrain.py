"""What an encoder sees before it drives."""

import pytest
import torch

from wrongturn_agents.models import build
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.methods.ppo.config import ImageConfig
from wrongturn_agents.training.methods.ppo.pretrain import pretrain
from wrongturn_protocol import SegmentationClass

ROAD_USERS = {SegmentationClass.VEHICLE, SegmentationClass.PEDESTRIAN}


@pytest.mark.usefixtures("small_networks")
@pytest.mark.parametrize(("traffic", "wanted"), [(0.7, ROAD_USERS), (0.0, set())])
def test_the_encoder_learns_from_pictures_of_those_whom_its_policy_will_meet(monkeypatch, traffic, wanted):
    config = ImageConfig(
        num_envs=32, traffic=traffic, pretraining_frames=64, pretraining_passes=1, pretraining_batch=16
    )
    model = build("ppo-image", seed=1, frozen=True)
    learned, loss_of = set(), model.segmentation_loss

    def recording(batch, **more):
        learned.update(batch["segmentation"].unique().tolist())
        return loss_of(batch, **more)

    monkeypatch.setattr(model, "segmentation_loss", recording)
    pretrain(model, config, device=torch.device("cpu"), seed=1, budget=Budget(1, None), threads=1)
    assert SegmentationClass.ROAD in learned
    assert learned & ROAD_USERS == wanted
