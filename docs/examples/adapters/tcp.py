"""TCP (Wu et al., NeurIPS 2022) drives in Wrongturn: one camera, target point and command, two branches of control.

Code: https://github.com/OpenDriveLab/TCP (Apache-2.0), whose README links the training data; take a checkpoint that its
``TCP/train.py`` writes. With that checkout on PYTHONPATH and the file's name in TCP_WEIGHTS::

    wrongturn run tcp:Tcp --suite smoke@3

What changes: the steering is 1.3 times that for CARLA's car, because Wrongturn's turns less at the same number; and of
throttle and brake together the smaller is subtracted from the greater, because any brake of Wrongturn's car cuts its
throttle. Nothing else.
"""

import os
from collections import deque
from math import atan2, pi

import numpy as np

from wrongturn_faults import CARLA, one_hot
from wrongturn_protocol import Rig, RigCamera

STEER = 1.3
"""Steering of Wrongturn's car for the curve that CARLA's takes at 1, by the bicycle model of World on Rails."""
MEAN, DEVIATION = np.float32([0.485, 0.456, 0.406]), np.float32([0.229, 0.224, 0.225])


def load(weights):
    """Return the authors' network as a function of arrays."""
    import torch
    from TCP.config import GlobalConfig
    from TCP.model import TCP

    model = TCP(GlobalConfig()).eval()
    kept = torch.load(weights, map_location="cpu")["state_dict"]
    model.load_state_dict({name.replace("model.", ""): value for name, value in kept.items()}, strict=False)

    def network(image, state, target_point):
        with torch.no_grad():
            given = model(*(torch.from_numpy(one) for one in (image, state, target_point)))
        return {name: given[name].numpy() for name in ("pred_wp", "mu_branches", "sigma_branches")}

    return network


class Pid:
    """The controller of TransFuser and TCP: its integral part is the mean of the last n errors, zeros at first."""

    def __init__(self, proportional, integral, derivative, n):
        self.gains, self.errors = (proportional, integral, derivative), deque([0.0] * n, maxlen=n)

    def step(self, error):
        change = error - self.errors[-1]
        self.errors.append(error)
        return float(np.dot(self.gains, (error, np.mean(self.errors), change)))


class Tcp:
    """TCP: single camera, target point and command; its own controllers mix trajectory and control branch."""

    track = "camera"
    rig = Rig(
        cameras=(RigCamera(width=900, height=256, fov=100, forward=-1.5, up=2.0),),
        navigation=("command", "target_points"),
        rate=20,
    )

    def __init__(self, network=None):
        self.network = network or load(os.environ["TCP_WEIGHTS"])
        self.reset(None)

    def reset(self, _space):
        self.turn, self.pace = Pid(0.75, 0.75, 0.3, 40), Pid(5.0, 0.5, 1.0, 40)
        self.steers = deque(maxlen=20)

    def act(self, observation):
        speed = float(observation["speed"][0])
        forward, left = observation["target_points"][0]
        target = np.float32([[-left, -forward]])  # TCP's frame: to the right, and backwards
        command = one_hot(int(observation["command"][0]), CARLA, 6)
        state = np.float32([[speed / 12.0, *target[0], *command]])
        image = (observation["rgb"] / np.float32(255.0) - MEAN) / DEVIATION
        given = self.network(np.ascontiguousarray(image.transpose(2, 0, 1)[None]), state, target)
        points = given["pred_wp"].reshape(4, 2) * (1.0, -1.0)  # to the right, and forward
        by_path = np.array(self.follow(points, target[0] * (1.0, -1.0), speed))
        gain, steer = 2.0 * mode(given["mu_branches"].reshape(2), given["sigma_branches"].reshape(2)) - 1.0
        by_branch = np.array([steer, max(gain, 0.0), max(-gain, 0.0)])
        turning = sum(abs(one) > 0.1 for one in self.steers) > 10
        main, other = (by_branch, by_path) if turning else (by_path, by_branch)
        steer, throttle, brake = np.clip(0.7 * main + 0.3 * other, (-1.0, 0.0, 0.0), (1.0, 0.75, 1.0))
        self.steers.append(steer)
        pull = -brake if brake > 0.5 else throttle - brake
        return np.clip(STEER * steer, -1.0, 1.0), max(pull, 0.0), max(-pull, 0.0)

    def follow(self, points, target, speed):
        """Return the controls that follow the trajectory, points (4, 2) half a second apart."""
        desired = 2.0 * np.linalg.norm(np.diff(points, axis=0), axis=1).mean()
        middles = np.linalg.norm((points[1:] + points[:-1]) / 2.0, axis=1)
        aim, last, ahead = map(angle, (points[np.argmin(abs(4.0 - middles))], points[-1] - points[-2], target))
        if abs(ahead) < abs(aim) or (abs(ahead - last) > 0.3 and target[1] < 10.0):
            aim = ahead
        steer = min(max(self.turn.step(aim), -1.0), 1.0)
        throttle = min(max(self.pace.step(min(max(desired - speed, 0.0), 0.25)), 0.0), 0.75)
        if desired < 0.4 or speed > 1.1 * desired:
            return steer, 0.0, 1.0
        return steer, throttle, 0.0


def angle(point):
    """Return the angle of a point (right, forward) from straight on; 1 is a right angle to the right."""
    return atan2(*point) * 2.0 / pi


def mode(alpha, beta):
    """Return the modes of Beta distributions in [0, 1]; where both ends are modes, the means."""
    inside = (np.maximum(alpha, 1.0) - 1.0) / np.maximum(np.maximum(alpha, 1.0) + np.maximum(beta, 1.0) - 2.0, 1e-5)
    return np.where((alpha <= 1.0) & (beta <= 1.0), alpha / np.maximum(alpha + beta, 1e-5), inside)
