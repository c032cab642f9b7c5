import warnings

import numpy as np
import pytest
from stable_baselines3.common.env_checker import check_env

from wrongturn_agents.training.action import controls
from wrongturn_sim import WrongturnSimEnv


@pytest.mark.parametrize(
    ("action", "expected"),
    [
        ((0.25, 0.5), (0.25, 0.5, 0.0)),
        ((-0.25, -0.5), (-0.25, 0.0, 0.5)),
        ((3.0, 7.0), (1.0, 1.0, 0.0)),
        ((-3.0, -7.0), (-1.0, 0.0, 1.0)),
    ],
)
def test_accelerate_is_throttle_or_brake(action, expected):
    assert controls(np.array([action, action])).tolist() == [list(expected)] * 2


@pytest.mark.slow
def test_stable_baselines_accepts_the_single_environment():
    env = WrongturnSimEnv("junctions", "state")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # advice on images and on symmetric actions
        check_env(env, warn=True)
