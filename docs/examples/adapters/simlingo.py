"""SimLingo (Renz et al., CVPR 2025) drives in Wrongturn: one camera and a sentence.

Code: https://github.com/RenzKa/simlingo (see the licence there). Weights: https://huggingface.co/RenzKa/simlingo. Write
``load`` from ``setup`` and ``tick`` of its ``team_code/agent_simlingo.py``, which make the model and the prompt's
tokens::

    wrongturn run simlingo:SimLingo --suite smoke@3

What changes: the sentence is Wrongturn's, at the place of ``go left at the next intersection in 11 meter``; and
Wrongturn's tracker drives along the route at the pace of the speed waypoints, in place of the authors' PID. Nothing
else.
"""

import numpy as np
from PIL import Image

from wrongturn_protocol import Rig, RigAction, RigCamera
from wrongturn_protocol.observations import text

MEAN, DEVIATION = np.float32([0.485, 0.456, 0.406]), np.float32([0.229, 0.224, 0.225])
ROWS = 359
"""Rows of the picture that are kept: all but the lowest 4.8 of 16 parts, which show the bonnet."""
TILE = 448
"""Width and height of the two tiles that InternVL2 is shown, pixels."""


class SimLingo:
    """SimLingo: one camera and a sentence; a route, and waypoints a quarter of a second apart.

    Args:
        network: takes pictures (1, 1, 2, 3, 448, 448), a prompt and the speed in m/s (1, 1). It returns speed waypoints
            (1, 10, 2) and the route (1, 20, 2), metres forward and to the right of the car's middle.
    """

    track = "words"
    rig = Rig(
        cameras=(RigCamera(width=1024, height=512, fov=110, forward=-1.5, up=2.0, jpeg=95),),
        navigation=("sentence",),
        sentences=("plain", "distance"),
        rate=20,
        action=RigAction(kind="waypoints", times=tuple(0.25 * n for n in range(1, 11)), side="right"),
    )

    def __init__(self, network=None):
        self.network = network or load()

    def reset(self, _space):
        """Remember nothing: every answer depends on what is seen and said now."""

    def act(self, observation):
        speed = round(float(observation["speed"][0]), 1)
        prompt = f"Current speed: {speed} m/s. Command: {text(observation['sentence'])} Predict the waypoints."
        given = self.network(tiles(observation["rgb"]), prompt, np.float32([[speed]]))
        waypoints, route = (np.asarray(one, float).reshape(n, 2) for one, n in zip(given[:2], (10, 20), strict=True))
        beyond = route[-1] + 100.0 * (route[-1] - route[-2])  # the route has 20 m, and a fast car drives farther
        path, way = measured(np.vstack([route, beyond]))
        pace = measured(waypoints)[1][1:]
        return np.stack([np.interp(pace, way, path[:, axis]) for axis in (0, 1)], axis=1)


def load():
    """Return the authors' network; with their code installed, as the module's docstring says."""
    raise NotImplementedError("simlingo: write load() from team_code/agent_simlingo.py, or give SimLingo a network")


def tiles(picture):
    """Return the picture (512, 1024, 3) as InternVL2 takes it: two tiles side by side, normalised as ImageNet's are."""
    wide = np.asarray(Image.fromarray(picture[:ROWS]).resize((2 * TILE, TILE)), np.float32)
    normal = (wide / np.float32(255.0) - MEAN) / DEVIATION
    return normal.reshape(TILE, 2, TILE, 3).transpose(1, 3, 0, 2)[None, None]


def measured(points):
    """Return the car's place (0, 0) and the points behind it, (n + 1, 2), and the way to each, metres."""
    path = np.vstack([np.zeros((1, 2)), points])
    return path, np.concatenate([[0.0], np.hypot(*np.diff(path, axis=0).T).cumsum()])
