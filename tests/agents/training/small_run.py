"""Trainings of seconds: PPO on two cars and a handful of decisions, and settings for small networks."""

from wrongturn_agents.models import build
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.driving_env import DrivingVecEnv
from wrongturn_agents.training.method import find_method
from wrongturn_agents.training.methods.ppo.ppo import WrongturnPPO
from wrongturn_agents.training.methods.ppo.seen_env import SeenVecEnv
from wrongturn_agents.training.stopwatch import Stopwatch

SMALL = (
    "num_envs=2",
    "n_steps=6",
    "batch_size=6",
    "n_epochs=2",
    "journeys=2",
    "brief_journeys=1",
    "patience=2",
    "steps=24",
)


def settings_of(algorithm, *options):
    """A method's settings, with some options changed."""
    return find_method(algorithm).settings().with_options(options)


def small_ppo(algorithm, *options, steps=1000, **more):
    """An untrained agent and its environments."""
    config = settings_of(algorithm, *SMALL, *options)
    agent = build(algorithm, seed=1, **more)
    driving = DrivingVecEnv(
        config.num_envs,
        keys=config.keys,
        town="Town01",
        track=config.track,
        task="cruise",
        strict=True,
        record=False,
        reward_divisor=config.reward_divisor,
    )
    envs = SeenVecEnv(
        driving,
        disturb=agent.disturb if config.disturbed else None,
        encode=agent.encode if config.frozen else None,
        width=agent.encoder.width,
    )
    watch = Stopwatch(driving.device)
    return WrongturnPPO(
        config, envs, model=lambda: agent, budget=Budget(steps, None), stopwatch=watch, seed=1, device="cpu"
    )


def rolled(ppo):
    """The same after a rollout."""
    ppo._setup_learn(1000)
    callback = ppo._init_callback(None)
    ppo.collect_rollouts(ppo.env, callback, ppo.rollout_buffer, ppo.n_steps)
    return ppo
