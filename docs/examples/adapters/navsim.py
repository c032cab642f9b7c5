"""NAVSIM's camera-only baseline, Latent TransFuser (Dauner et al., NeurIPS 2024), drives in Wrongturn.

Code: https://github.com/autonomousvision/navsim (Apache-2.0). Weights: https://huggingface.co/autonomousvision/navsim_baselines,
folder ``ltf``. With the devkit installed and the file's name in NAVSIM_WEIGHTS::

    wrongturn run navsim:Navsim --suite smoke@3

What changes: pictures are drawn at a quarter of 1,920 x 1,080, the size to which the devkit shrinks them, without lens
distortion; the cameras' pitch of a degree is a shift of the horizon; accelerations come from speed and steering.
Nothing else.
"""

import os
from math import atan, degrees, radians, tan

import numpy as np

from wrongturn_faults import NAVSIM, one_hot
from wrongturn_protocol import Rig, RigAction, RigCamera
from wrongturn_protocol.vehicle import VEHICLE

FOCAL = 1545.0 / 4.0
"""Focal length, pixels of a quarter of the published pictures."""
REAR_AXLE = VEHICLE.rear_axle
"""nuPlan measures from the rear axle, Wrongturn from the car's middle, metres."""


def load(weights):
    """Return the authors' network as a function of arrays."""
    import torch
    from navsim.agents.transfuser.transfuser_config import TransfuserConfig
    from navsim.agents.transfuser.transfuser_model import TransfuserModel

    model = TransfuserModel(TransfuserConfig(latent=True)).eval()
    kept = torch.load(weights, map_location="cpu")["state_dict"]
    model.load_state_dict({name.replace("agent._transfuser_model.", ""): value for name, value in kept.items()})

    def network(camera_feature, status_feature):
        features = {"camera_feature": camera_feature, "status_feature": status_feature}
        tensors = {name: torch.from_numpy(one) for name, one in features.items()}
        with torch.no_grad():
            return model({**tensors, "lidar_feature": torch.zeros(1, 1, 256, 256)})["trajectory"].numpy()

    return network


def camera(name, forward, left, yaw, pitch):
    """Return a camera of nuPlan's car, by the calibration in its logs, from the rear axle: metres, degrees."""
    horizon = 140.0 - FOCAL * tan(radians(pitch))  # looking down by a degree moves the horizon, and is drawn far faster
    place = {"forward": forward - REAR_AXLE, "left": left, "up": 1.85, "yaw": yaw, "horizon": horizon}
    return RigCamera(name=name, width=480, height=270, fov=2.0 * degrees(atan(240.0 / FOCAL)), **place)


class Navsim:
    """Latent TransFuser of NAVSIM: three cameras, command of four and the car's state; poses of four seconds."""

    track = "camera"
    rig = Rig(
        cameras=(
            camera("l0", 1.63, 0.12, 54.9, 0.8),
            camera("f0", 1.66, -0.01, 0.0, 1.3),
            camera("r0", 1.62, -0.16, -55.6, 0.8),
        ),
        navigation=("command",),
        action=RigAction(
            kind="waypoints", times=(0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0), side="left", behind=REAR_AXLE
        ),
    )

    def __init__(self, network=None):
        self.network = network or load(os.environ["NAVSIM_WEIGHTS"])
        self.reset(None)

    def reset(self, _space):
        self.before = None

    def act(self, observation):
        left, front, right = (observation[name][7:-7] for name in ("l0", "f0", "r0"))
        stitched = np.concatenate([left[:, 104:-104], front, right[:, 104:-104]], axis=1)  # 256 x 1,024
        seen = np.ascontiguousarray(stitched.transpose(2, 0, 1)[None], np.float32) / np.float32(255.0)
        speed, steering = (float(observation[name][0]) for name in ("speed", "steering"))
        gain = 0.0 if self.before is None else (speed - self.before) * self.rig.rate
        self.before = speed
        curvature = -tan(steering * VEHICLE.max_wheel_angle) / VEHICLE.wheelbase  # left is positive
        command = one_hot(int(observation["command"][0]), NAVSIM)
        status = np.float32([[*command, speed, 0.0, gain, speed * speed * curvature]])
        return self.network(seen, status)[0, :, :2]  # x and y; the tracker needs no heading
