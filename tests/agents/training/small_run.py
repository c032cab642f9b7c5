"""Trainings of seconds: PPO on two cars and a handful of decisions, and settings for small networks."""

from wrongturn_agents.models import build
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.cars import training_cars
from wrongturn_agents.training.method import find_method
from wrongturn_agents.training.methods.ppo.ppo import WrongturnPPO
from wrongturn_agents.training.methods.ppo.rollout import SeenVecEnv

SMALL = (
    *("num_envs=2", "n_steps=6", "batch_size=6", "n_epochs=2", "journeys=2", "brief_journeys=1", "patience=2"),
    "steps=24",
)
HERE = {"device": "cpu", "threads": 1}


def settings_of(algorithm, *options):
    """A method's settings, with some options changed."""
    return find_method(algorithm).settings().with_options(options)


def small_ppo(algorithm, *options, steps=1000):
    """An untrained agent and its environments."""
    config = settings_of(algorithm, *SMALL, "traffic=0", *options)
    agent = build(algorithm, seed=1)
    driving = training_cars(settings=config, threads=1)
    envs = SeenVecEnv(driving, agent, config)
    return WrongturnPPO(config, envs, agent, Budget(steps, None), seed=1, device="cpu")


def rolled(ppo):
    """The same after a rollout."""
    ppo._setup_learn(1000)
    callback = ppo._init_callback(None)
    ppo.collect_rollouts(ppo.env, callback, ppo.rollout_buffer, ppo.n_steps)
    return ppo
