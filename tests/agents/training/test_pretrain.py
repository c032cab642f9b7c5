"""What an encoder sees before it drives, and how its agent drives then."""

import numpy as np
import pytest
import torch

from wrongturn_agents.models import build
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.cars import training_cars
from wrongturn_agents.training.method import load
from wrongturn_agents.training.methods.ppo.config import ImageConfig
from wrongturn_agents.training.methods.ppo.pretrain import pretrain
from wrongturn_agents.training.run import train
from wrongturn_protocol import SegmentationClass

CARS = 16
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


@pytest.mark.slow
@pytest.mark.usefixtures("small_networks")
def test_a_short_training_beats_a_random_policy(tmp_path):
    """The agent that takes the least: ppo-image, whose small encoder is pretrained and frozen."""
    random = np.random.default_rng(1)
    by_chance = mean_reward(lambda _: random.uniform(-1.0, 1.0, (CARS, 2)))
    options = (
        *(f"num_envs={CARS}", "n_steps=32", "batch_size=128", "n_epochs=6", "learning_rate=1e-3", "augment=false"),
        *("projection_learning_rate=1", "encoder_learning_rate=1", "activation=relu"),
        *("pretraining_frames=256", "pretraining_batch=32", "pretraining_passes=1"),
        # So few steps suffice for a short horizon, and for what is learned first: not to leave the road.
        *("gamma=0.9", "reward_divisor=30", "failure_penalty=2", "standing_penalty=2", "standing_cost=0"),
        *("accelerate=0", "time_limit=8", "inside_junctions=0", "traffic=0", "journeys=1", "brief_journeys=1"),
        "patience=1",
    )
    # One thread: with networks so small, more would mostly wait for each other.
    train("ppo-image", directory=tmp_path, seed=1, steps=4096, device="cpu", threads=1, options=options)
    model = load(tmp_path / "last.pt").model

    @torch.inference_mode()
    def learned(observation):
        return model.act(model.features(observation), observation["command"]).numpy()

    # By chance 365, standing still about 460. Trainings of two seeds came to 604 and 717.
    assert mean_reward(learned) > by_chance + 150.0


def mean_reward(act, episodes=32):
    """Return the paper's reward of an episode, in drives of at most 4 s that are not trained on."""
    cars = training_cars(
        CARS, settings=ImageConfig(traffic=0.0, time_limit=4.0, inside_junctions=0.0), seed=10**6, threads=1
    )
    observation, rewards = cars.reset(), []
    while len(rewards) < episodes:
        observation, _, _, infos = cars.step(act(observation))
        rewards += [info["episode"]["r"] for info in infos if info]
    cars.close()
    return float(np.mean(rewards))
