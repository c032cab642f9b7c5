"""Observations for calibration and comparison, drawn again each time instead of kept in files."""

from typing import Any, Final

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from wrongturn_protocol import TRAINING_WEATHERS, Track
from wrongturn_sim import WrongturnVectorEnv

EGOS: Final = 20
"""Cars that are recorded side by side: an observation's car drove the one this many places before, too."""
_APART: Final = 4
"""Decisions between two recorded observations of a car."""


def record_observations(track: Track | str, number: int, *, seed: int = 0, town: str = "Town01") -> dict[str, Any]:
    """Record what cars see that cruise about a town with random steering.

    They start beside the lane's centre, askew and at any speed, mostly near junctions and bends, in the training
    weathers. They restart after they leave the road. So they see the road from everywhere that a driver can get to.

    The same arguments give the same observations: one array (``number``, ...) for each key of the track.
    """
    if number < 1:
        raise ValueError(f"number: is {number}; record 1 observation or more")
    random = np.random.default_rng(seed)
    envs = WrongturnVectorEnv(
        EGOS,
        town,
        track,
        task="cruise",
        strict=True,
        record=False,
        weather=TRAINING_WEATHERS,
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    kept: list[dict[str, NDArray[Any]]] = []
    try:
        observation, _ = envs.reset(seed=seed)
        speeds = random.uniform(2.0, 9.0, EGOS)
        steer = np.zeros(EGOS)
        while len(kept) * EGOS < number:
            kept.append({key: np.array(array) for key, array in observation.items()})
            for _ in range(_APART):
                steer = np.clip(0.8 * steer + random.normal(0.0, 0.08, EGOS), -1.0, 1.0)
                pedal = np.clip((speeds - np.asarray(observation["speed"])[:, 0]) * 0.3, -1.0, 1.0)
                actions = np.stack([steer, np.maximum(pedal, 0.0), np.maximum(-pedal, 0.0)], 1).astype(np.float32)
                observation, *_ = envs.step(actions)
    finally:
        envs.close()
    return {key: np.concatenate([one[key] for one in kept])[:number] for key in kept[0]}
