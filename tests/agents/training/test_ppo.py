import copy

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from metres_driven import by_chance, metres
from small_run import HERE, SMALL, rolled, settings_of, small_ppo
from stable_baselines3.common.vec_env import DummyVecEnv

from wrongturn_agents.models import build
from wrongturn_agents.training.action import ACTION_SPACE
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.method import load
from wrongturn_agents.training.methods.ppo.ppo import WrongturnPPO
from wrongturn_agents.training.methods.ppo.rollout import FEATURES
from wrongturn_agents.training.run import train

pytestmark = pytest.mark.usefixtures("small_networks")


def weights(ppo):
    return {name: tensor.clone() for name, tensor in ppo.policy.model.state_dict().items()}


def changed(ppo, before):
    return {name for name, tensor in ppo.policy.model.state_dict().items() if not torch.equal(tensor, before[name])}


def test_an_update_changes_the_policy_and_tells_of_it():
    ppo = rolled(small_ppo("ppo-segmentation", "learning_rate=1e-5"))
    before = weights(ppo)
    ppo.train()
    assert changed(ppo, before)
    assert ppo.figures["minibatches"] == 4
    assert ppo.figures["epochs"] == 2
    assert ppo.figures["std_steer"] == pytest.approx(0.24, abs=0.01)
    assert ppo.figures["reverted"] == 0
    assert 0 < ppo.figures["divergence"] < 0.1


def test_the_policy_that_drove_has_not_diverged_and_an_update_stops_where_it_has_gone_too_far():
    ppo = rolled(small_ppo("ppo-segmentation", "kl_stop=-1"))
    _, terms, divergence = ppo._loss(next(ppo.rollout_buffer.get(12)))
    assert divergence.item() == pytest.approx(0.0, abs=1e-6)
    assert terms["clip_fraction"] == 0.0
    before = weights(ppo)
    ppo.train()
    assert ppo.figures["minibatches"] == 0
    assert not changed(ppo, before)


def test_an_update_that_loses_the_policy_is_undone():
    ppo = rolled(small_ppo("ppo-segmentation", "learning_rate=1e-5"))
    ppo.train()
    assert ppo.figures["reverted"] == 0
    before, moments = weights(ppo), copy.deepcopy(ppo.policy.optimizer.state_dict()["state"])
    ppo.lr_schedule = lambda _: 10.0
    ppo.train()
    assert ppo.figures["reverted"] == 1
    assert ppo.figures["minibatches"] > 0
    assert not changed(ppo, before)
    after = ppo.policy.optimizer.state_dict()["state"]
    assert after.keys() == moments.keys()
    assert all(torch.equal(after[i][name], value) for i, kept in moments.items() for name, value in kept.items())
    assert ppo.caution == 0.5
    ppo.lr_schedule = lambda _: 1e-6
    ppo.train()
    assert ppo.figures["reverted"] == 0
    assert ppo.figures["learning_rate"] == pytest.approx(0.5e-6)
    assert changed(ppo, before)


@pytest.mark.parametrize("options", [(), ("batch_size=12", "n_epochs=1")])
def test_the_very_first_update_can_be_undone_and_its_last_step_is_looked_at_too(options):
    ppo = rolled(small_ppo("ppo-segmentation", "learning_rate=100", *options))
    before = weights(ppo)
    ppo.train()
    assert ppo.figures["minibatches"] >= 1
    assert ppo.figures["reverted"] == 1
    assert not changed(ppo, before)
    assert not ppo.policy.optimizer.state


@pytest.mark.parametrize(
    ("algorithm", "share", "projection"),
    [("ppo-segmentation", 1.0, None), ("ppo-image", None, 0.1), ("ppo-auxiliary", 0.2, 1.0)],
)
def test_convolutions_and_projection_have_their_own_learning_rates(algorithm, share, projection):
    ppo = small_ppo(algorithm, *["projection_learning_rate=0.1"] * (projection == 0.1))  # by default it is 1
    ppo._update_current_progress_remaining(0, 0)
    ppo._update_learning_rate(ppo.policy.optimizer)
    of = {id(parameter): group["lr"] for group in ppo.policy.optimizer.param_groups for parameter in group["params"]}
    rate = ppo.config.learning_rate
    for name, parameter in ppo.policy.named_parameters():
        convolution = name.startswith("model.encoder.network.")
        if parameter.requires_grad:
            expected = share if convolution else projection if name.startswith("model.encoder.projection.") else 1.0
            assert of.pop(id(parameter)) == pytest.approx(rate * expected), name
        else:
            assert convolution or name.startswith("model.encoder.decoder.")
    assert not of


def test_the_learning_rate_falls_to_a_tenth():
    ppo = rolled(small_ppo("ppo-segmentation", "learning_rate=1e-3", steps=1000))
    rates = []
    for steps in (0, 500, 1000):
        ppo._update_current_progress_remaining(steps, 0)
        ppo._update_learning_rate(ppo.policy.optimizer)
        rates.append(ppo.policy.optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([1e-3, 5.5e-4, 1e-4])


@pytest.mark.parametrize("auxiliary", [True, False])
def test_the_auxiliary_loss_teaches_the_decoder_and_both_sigmas(auxiliary):
    ppo = rolled(small_ppo("ppo-auxiliary", "augment=false", f"auxiliary={auxiliary}"))
    ppo.policy.set_training_mode(True)
    ppo.policy.optimizer.zero_grad(set_to_none=True)
    loss, terms, _ = ppo._loss(next(ppo.rollout_buffer.get(4)))
    loss.backward()
    taught = {name for name, one in ppo.policy.named_parameters() if one.grad is not None and one.grad.any()}
    for part in ("encoder.decoder.", "encoder.segmenting.", "homoscedastic.sigma_rl", "homoscedastic.sigma_aux"):
        assert any(part in name for name in taught) is auxiliary, part
    assert any(name.startswith("model.branches.") for name in taught)
    assert (terms.get("auxiliary_loss", 0.0) > 0.5) == auxiliary


def test_a_frozen_encoder_is_buffered_by_its_features_and_stays():
    ppo = rolled(small_ppo("ppo-image", "augment=false"))
    assert set(ppo.rollout_buffer.observations) == {"speed", "steering", "command", FEATURES}
    assert ppo.rollout_buffer.observations[FEATURES].dtype == torch.bfloat16
    before = weights(ppo)
    ppo.train()
    found = changed(ppo, before)
    assert any(name.startswith("encoder.projection") for name in found)
    assert not any(name.startswith("encoder.network") for name in found)


def test_augmented_frames_are_what_is_kept():
    ppo = small_ppo("ppo-auxiliary")
    torch.manual_seed(3)
    ppo.env.seed(7)
    seen = ppo.env.reset()
    ppo.env.seed(7)
    plain = ppo.env.venv.reset()
    assert seen["rgb"].dtype == torch.uint8
    assert not torch.equal(seen["rgb"], plain["rgb"])
    assert torch.equal(seen["segmentation"], plain["segmentation"])


class Bandit(gymnasium.Env):
    """An episode of one decision: steering by 0.5 to the commanded side pays most."""

    def __init__(self, width):
        number = spaces.Box(-1.0, 1.0, (1,), np.float32)
        self.observation_space = spaces.Dict(
            speed=number, steering=number, command=spaces.Box(1, 2, (1,), np.int64),
            **{FEATURES: spaces.Box(-1.0, 1.0, (width,), np.float16)},
        )  # fmt: skip
        self.action_space = ACTION_SPACE

    def reset(self, **options):
        super().reset(**options)
        self.seen = self.observation_space.sample()
        return self.seen, {}

    def step(self, action):
        wanted = 0.5 if self.seen["command"][0] == 2 else -0.5
        return self.seen, -abs(float(action[0]) - wanted), True, False, {}


def test_it_learns_what_each_command_asks_for():
    config = settings_of(
        "ppo-image", *SMALL, "num_envs=16", "n_steps=16", "batch_size=64", "learning_rate=3e-3", "n_epochs=4"
    )
    agent = build("ppo-image", seed=1)
    envs = DummyVecEnv([lambda: Bandit(agent.encoder.width)] * config.num_envs)
    envs.action_space.seed(1)
    ppo = WrongturnPPO(config, envs, agent, Budget(6144, None), seed=1, device="cpu")

    def error():
        observation = {key: torch.as_tensor(array) for key, array in envs.reset().items()}
        command = torch.arange(16).remainder(2).add(1).view(16, 1)
        with torch.no_grad():
            steer = agent.act(ppo.policy.features(observation), command)[:, 0]
        return (steer - torch.where(command[:, 0] == 2, 0.5, -0.5)).abs().mean().item()

    before = error()
    ppo.learn(6144)
    assert error() < 0.4 * before


@pytest.mark.soak  # CI lets it learn from a bandit
def test_a_short_training_beats_a_random_policy(tmp_path):
    options = (
        *("num_envs=16", "n_steps=32", "batch_size=128", "n_epochs=6", "learning_rate=1e-3", "augment=false"),
        *("projection_learning_rate=1", "encoder_learning_rate=1", "activation=relu", "accelerate=0"),
        *("pretraining_frames=256", "pretraining_batch=32", "pretraining_passes=1"),
        # So few steps suffice for a short horizon, and for what is learned first: not to leave the road.
        *("gamma=0.9", "reward_divisor=30", "failure_penalty=2", "standing_penalty=2", "standing_cost=0"),
        *("time_limit=8", "inside_junctions=0", "traffic=0", "journeys=1", "brief_journeys=1", "patience=1"),
    )
    train("ppo-image", directory=tmp_path, seed=1, steps=4096, options=options, **HERE)
    model = load(tmp_path / "last.pt").model
    # By chance 7.7 m. This training came to 13.8 m, another seed to 18.9 m.
    assert metres(lambda seen, _: (model.drive(seen), None), pictures=True) > 1.3 * metres(by_chance())
