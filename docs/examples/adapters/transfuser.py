"""Latent TransFuser (Chitta et al., PAMI 2023) drives in Wrongturn: TransFuser without LiDAR, three cameras.

Code: https://github.com/autonomousvision/transfuser (MIT); its README links the weights, ``models_2022.zip``. With
``team_code_transfuser`` on PYTHONPATH and the folder ``models_2022/latentTF`` in TRANSFUSER_WEIGHTS::

    wrongturn run transfuser:TransFuser --suite smoke@3

What changes: Wrongturn's tracker follows the waypoints, in place of the authors' PID, whose steering is that of CARLA's
car; and there is no creeping after 55 s at rest. Nothing else.
"""

import os
from pathlib import Path

import numpy as np

from wrongturn_protocol import Rig, RigAction, RigCamera

LIDAR = 1.3
"""How far the LiDAR's frame, that of the network's waypoints, lies in front of the car's middle, metres."""


def load(folder):
    """Return the mean of the authors' networks in a folder, as they drive, as a function of arrays."""
    import json

    import torch
    from config import GlobalConfig
    from model import LidarCenterNet

    given = json.loads((Path(folder) / "args.txt").read_text())
    config = GlobalConfig(setting="eval")
    for name in ("n_layer", "use_target_point_image"):
        setattr(config, name, given.get(name, getattr(config, name)))
    architectures = given["image_architecture"], given["lidar_architecture"]
    models = []
    for file in sorted(Path(folder).glob("*.pth")):
        model = LidarCenterNet(config, "cpu", "latentTF", *architectures, bool(given["use_velocity"])).eval()
        kept = torch.load(file, map_location="cpu")
        model.load_state_dict({name.removeprefix("module."): value for name, value in kept.items()}, strict=False)
        models.append(model)
    empty, unseen = torch.zeros(1, 2, 256, 256), torch.zeros(1, 1, 256, 256)

    def network(image, target_point, velocity):
        with torch.no_grad():
            seen, target, speed = (torch.from_numpy(one) for one in (image, target_point, velocity))
            found = [model.forward_ego(seen, empty, target, unseen, speed)[0] for model in models]
            return torch.stack(found).mean(dim=0).numpy()

    return network


def camera(name, yaw):
    """Return a camera: the middle 320 x 160 of the published 960 x 480 at 120 degrees, which is all that is used."""
    return RigCamera(name=name, width=320, height=160, fov=60, forward=1.3, up=2.3, yaw=yaw)


class TransFuser:
    """Latent TransFuser: three cameras, target point and speed; four waypoints half a second apart."""

    track = "camera"
    rig = Rig(
        cameras=(camera("left", 60), camera("front", 0), camera("right", -60)),
        navigation=("target_points",),
        action=RigAction(kind="waypoints", times=(0.5, 1.0, 1.5, 2.0), side="right"),
    )

    def __init__(self, network=None):
        self.network = network or load(os.environ["TRANSFUSER_WEIGHTS"])

    def reset(self, _space):
        """Remember nothing: every answer depends on what is seen now."""

    def act(self, observation):
        stitched = np.concatenate([observation[name] for name in ("left", "front", "right")], axis=1)
        seen = stitched[:, 128:-128].transpose(2, 0, 1)[None]  # 704 of 960 columns; the network normalises 0..255
        forward, left = observation["target_points"][0]
        target = np.float32([[-left, -forward]])  # to the right, and backwards
        given = self.network(np.ascontiguousarray(seen, np.float32), target, observation["speed"].reshape(1, 1))
        return given[0] + (LIDAR, 0.0)
