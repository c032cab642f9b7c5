"""The agent of the paper behind this benchmark (Carton et al., IV 2021) drives in Wrongturn: image with auxiliary task.

Code and weights: https://github.com/CEA-LIST/AD-RobustnessEval (MIT); the frozen graph of TensorFlow 1 is named in its
README, ``frozen_graphs/frozen_graph.pb``. With the file's name in CARTON_GRAPH::

    wrongturn run carton:Carton --suite smoke@3

What changes: steerings are 1.3 times those for CARLA's car, because Wrongturn's turns less at the same number. Nothing
else.
"""

import os
from pathlib import Path

import numpy as np

from wrongturn_protocol import Rig, RigAction, RigCamera

STEER = 1.3
"""Steering of Wrongturn's car for the curve that CARLA's takes at 1, by the bicycle model of World on Rails."""
INCREMENT = 0.05
"""Greatest change of the steering in one of 20 decisions a second."""


def load(file):
    """Return the frozen graph as a function of arrays."""
    import tensorflow.compat.v1 as tf

    with tf.Graph().as_default() as graph:
        tf.import_graph_def(tf.GraphDef.FromString(Path(file).read_bytes()), name="")
    session = tf.Session(graph=graph)
    return lambda seen: session.run("model/split_2:0", {"input/Ob:0": seen})


class Carton:
    """Image with auxiliary task, of the paper's authors: one camera and the command; increments of the steering.

    The camera is the published one, 256 x 192 at 100 degrees, without the rows and columns that are cut off.
    """

    track = "camera"
    rig = Rig(
        cameras=(RigCamera(width=192, height=64, fov=2 * np.degrees(np.arctan(96 / 107.4)), horizon=26),),
        navigation=("command",),
        rate=20,
        action=RigAction(kind="increments"),
    )

    def __init__(self, network=None):
        self.network = network or load(os.environ["CARTON_GRAPH"])

    def reset(self, _space):
        """Remember nothing: the car says where its steering is."""

    def act(self, observation):
        seen = np.zeros((1, 64, 192, 9), np.float32)  # five planes stay empty: those of the auxiliary task
        seen[0, :, :, :3] = observation["rgb"] / np.float32(255.0)
        speed, steering = float(observation["speed"][0]), float(observation["steering"][0])
        seen[0, 0, :3, 3] = 3.6 * speed / 100.0, steering / STEER, observation["command"][0]  # CARLA's numbers, 1 to 4
        steer, pull = np.clip(np.reshape(self.network(seen), 2), -1.0, 1.0)
        return STEER * INCREMENT * steer, max(pull, 0.0), max(-pull, 0.0)
