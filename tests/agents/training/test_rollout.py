import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.buffers import DictRolloutBuffer

from wrongturn_agents.training.action import ACTION_SPACE
from wrongturn_agents.training.methods.ppo.rollout import DeviceRolloutBuffer

SPACE = spaces.Dict(
    {
        "rgb": spaces.Box(0, 255, (4, 6, 3), np.uint8),
        "command": spaces.Box(-1, 4, (1,), np.int64),
        "features": spaces.Box(-np.inf, np.inf, (5,), np.float16),
    }
)
STEPS, ENVS = 6, 3


def filled(kind, space, seed=0, **more):
    """A buffer after a rollout of noise."""
    buffer = kind(STEPS, space, ACTION_SPACE, device="cpu", gamma=0.97, gae_lambda=0.9, n_envs=ENVS, **more)
    random = np.random.default_rng(seed)
    for step in range(STEPS):
        observation = {
            name: random.integers(0, 5, (ENVS, *box.shape)).astype(box.dtype) for name, box in space.spaces.items()
        }
        observation["rgb"][:] = 10 * step + np.arange(ENVS)[:, None, None, None]
        buffer.add(
            observation,
            random.normal(size=(ENVS, 2)).astype(np.float32),
            random.normal(size=ENVS).astype(np.float32),
            random.random(ENVS) < 0.3,
            torch.tensor(random.normal(size=(ENVS, 1)), dtype=torch.float32),
            torch.tensor(random.normal(size=ENVS), dtype=torch.float32),
        )
    buffer.compute_returns_and_advantage(torch.tensor([[0.5], [1.0], [-1.0]]), np.array([True, False, False]))
    return buffer


def test_returns_are_stable_baselines_own():
    space = spaces.Dict({"rgb": SPACE["rgb"], "command": SPACE["command"]})
    ours, theirs = filled(DeviceRolloutBuffer, space), filled(DictRolloutBuffer, space)
    assert ours.advantages.numpy() == pytest.approx(theirs.advantages, abs=1e-5)
    assert ours.returns.numpy() == pytest.approx(theirs.returns, abs=1e-5)


def test_pictures_stay_bytes_and_every_frame_is_drawn_once():
    buffer = filled(DeviceRolloutBuffer, SPACE)
    torch.manual_seed(1)
    seen = []
    for samples in buffer.get(4):
        assert samples.observations["rgb"].dtype == torch.uint8
        assert samples.observations["command"].dtype == torch.int64
        assert samples.observations["features"].dtype == torch.bfloat16
        for row in range(len(samples.actions)):
            number = samples.observations["rgb"][row, 0, 0, 0].item()
            step, env = divmod(number, 10)
            seen.append(number)
            for name in ("actions", "values", "log_probs", "advantages", "returns"):
                field = {"values": "old_values", "log_probs": "old_log_prob"}.get(name, name)
                assert torch.equal(getattr(samples, field)[row], getattr(buffer, name)[step, env])
    assert sorted(seen) == sorted(10 * step + env for step in range(STEPS) for env in range(ENVS))
    assert seen != sorted(seen)
