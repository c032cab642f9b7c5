"""openpilot's driving model (comma.ai) drives in Wrongturn: two cameras, two frames, a desire; it answers with a plan.

Code and weights: https://github.com/commaai/openpilot (MIT), as of commit 00731a66. In ``selfdrive/modeld/models`` is
``supercombo.onnx``, from Git LFS, and the build writes ``supercombo_metadata.pkl`` there. With the folder's name in
OPENPILOT_MODELS::

    wrongturn run openpilot:Openpilot --suite smoke@3

What changes: LEFT and RIGHT are the desires ``turnLeft`` and ``turnRight``; and Wrongturn's tracker follows the plan's
first 2.5 s, in place of openpilot's controls. Nothing else. Other releases have other inputs: see their ``modeld.py``.
"""

import os
import pickle
from pathlib import Path

import cv2
import numpy as np

from wrongturn_faults import OPENPILOT, one_hot
from wrongturn_protocol import Rig, RigAction, RigCamera

FORWARD = 0.5
"""Place of the camera, the plan's origin, behind the windscreen: metres in front of the car's middle."""
POINTS = 33
"""Points of a plan. The point i is 10 (i / 32)² seconds from now."""
USED = range(1, 17)
"""Points that the tracker is given."""
DELAY_S = 0.3
"""What openpilot takes for the delay of its steering, seconds, with an actuator delay of 0.1 s."""


def load(folder):
    """Return the model as a function of its inputs by name, and its outputs by name."""
    import onnxruntime

    session = onnxruntime.InferenceSession(str(Path(folder) / "supercombo.onnx"))
    slices = pickle.loads((Path(folder) / "supercombo_metadata.pkl").read_bytes())["output_slices"]  # noqa: S301
    types = {one.name: np.float16 if "float16" in one.type else np.float32 for one in session.get_inputs()}

    def network(**inputs):
        (given,) = session.run(None, {name: inputs[name].astype(kind) for name, kind in types.items()})
        return {name: given[:, part] for name, part in slices.items()}

    return network


def camera(name, focal, horizon):
    """Return one of the calibrated pictures, whose horizon openpilot's warp brings to the same row in any car."""
    fov = 2.0 * np.degrees(np.arctan(256.0 / focal))
    return RigCamera(
        name=name, width=512, height=256, fov=fov, horizon=horizon, forward=FORWARD, up=1.22, history=2
    )  # fmt: skip


class Openpilot:
    """openpilot: a narrow and a wide camera, two frames of 20 per second, a desire; a plan of ten seconds."""

    track = "camera"
    rig = Rig(
        cameras=(camera("road", 910.0, 47.6), camera("wide", 455.0, 151.8)),
        navigation=("command",),
        rate=20,
        action=RigAction(
            kind="waypoints", times=tuple(10.0 * (i / 32) ** 2 for i in USED), side="right", behind=-FORWARD
        ),
    )

    def __init__(self, network=None):
        self.network = network or load(os.environ["OPENPILOT_MODELS"])
        self.reset(None)

    def reset(self, _space):
        self.desires = np.zeros((1, 100, 8), np.float32)
        self.features = np.zeros((1, 99, 512), np.float32)
        self.curvatures = np.zeros((1, 100, 1), np.float32)
        self.before = np.zeros(8)

    def act(self, observation):
        desire = np.array(one_hot(int(observation["command"][0]), OPENPILOT, 8))
        desire[0] = 0.0
        self.desires = pushed(self.desires, np.where(desire - self.before > 0.99, desire, 0.0))  # a pulse as it begins
        self.before = desire
        given = self.network(
            input_imgs=planes(observation["road"]),
            big_input_imgs=planes(observation["wide"]),
            desire=self.desires,
            traffic_convention=np.float32([[1.0, 0.0]]),  # Wrongturn's towns drive on the right
            lateral_control_params=np.float32([[observation["speed"][0], DELAY_S]]),
            prev_desired_curv=self.curvatures,
            features_buffer=self.features,
        )
        self.features = pushed(self.features, given["hidden_state"][0])
        self.curvatures = pushed(self.curvatures, given["desired_curvature"][0, :1])
        hypotheses = given["plan"].reshape(5, 2 * POINTS * 15 + 1)  # means, deviations, weight
        likeliest = hypotheses[np.argmax(hypotheses[:, -1])]
        return likeliest[: POINTS * 15].reshape(POINTS, 15)[USED.start : USED.stop, :2]  # forward and to the right


def pushed(buffer, newest):
    """Return a buffer (1, n, …) with its oldest row left out and a newest one behind."""
    return np.concatenate([buffer[:, 1:], np.asarray(newest, np.float32)[None, None]], axis=1)


def planes(frames):
    """Return two frames (2, 256, 512, 3) as twelve planes (1, 12, 128, 256) of YUV 4:2:0, the older frame first."""
    found = []
    for frame in frames:
        yuv = cv2.cvtColor(frame, cv2.COLOR_RGB2YUV_I420)
        y, u, v = yuv[:256], yuv[256:320].reshape(128, 256), yuv[320:].reshape(128, 256)
        found += [y[::2, ::2], y[1::2, ::2], y[::2, 1::2], y[1::2, 1::2], u, v]
    return np.stack(found)[None].astype(np.float32)
