"""What the policy sees of the environments: pictures augmented or masked, and encoded where the encoder is frozen."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn
from torch import Tensor

from wrongturn_agents.training.rollout import Observations
from wrongturn_agents.training.stopwatch import Stopwatch

ROAD: int = 1
"""The class of a segmentation that is never masked: without it nobody could drive."""
FEATURES = "features"
"""The key of a frozen encoder's features, in the place of the picture."""


def masked(segmentation: Tensor, probability: float, classes: int = 11) -> Tensor:
    """Frames (b, h, w) in which each class but the road's became class 0, unlabelled, with this probability."""
    count = len(segmentation)
    table = torch.arange(classes, device=segmentation.device, dtype=torch.uint8).repeat(count, 1)
    lost = torch.rand((count, classes), device=segmentation.device) < probability
    lost[:, ROAD] = False
    table[lost] = 0
    rows = torch.arange(count, device=segmentation.device)[:, None, None]
    return table[rows, segmentation.long()]


class SeenVecEnv(VecEnvWrapper):  # type: ignore[misc]
    """Environments as the policy sees them.

    It is the frame that the policy acted on that is kept and learnt from: augmentation belongs to the world that is
    driven in, not to the loss, so that the policy's ratio is 1 where nothing was learnt yet.

    Args:
        envs: give tensors on the device.
        augment: RGB (b, h, w, 3) uint8 to the same; None leaves it.
        mask: probability of each class of a segmentation to be unseen.
        encode: the frozen encoder: RGB (b, h, w, 3) uint8 to features (b, ...); each frame is encoded once.
        stopwatch: counts all of it as ``encode``.
    """

    def __init__(
        self,
        envs: VecEnv,
        *,
        augment: Callable[[Tensor], Tensor] | None = None,
        mask: float = 0.0,
        encode: Callable[[Tensor], Tensor] | None = None,
        stopwatch: Stopwatch | None = None,
    ) -> None:
        self._augment = augment
        self._mask = mask
        self._encode = encode
        self._stopwatch = stopwatch or Stopwatch(torch.device("cpu"))
        space = dict(envs.observation_space.spaces)
        if encode is not None:
            rgb = torch.zeros((1, *space.pop("rgb").shape), dtype=torch.uint8, device=envs.get_attr("device", 0)[0])
            shape = tuple(encode(rgb).shape[1:])
            space[FEATURES] = spaces.Box(-np.inf, np.inf, shape, np.float16)
        super().__init__(envs, observation_space=spaces.Dict(space))

    def reset(self) -> Observations:
        """Begin all trials anew."""
        return self._seen(self.venv.reset())

    def step_wait(self) -> VecEnvStepReturn:
        """As the environments', with what is seen."""
        observation, rewards, dones, infos = self.venv.step_wait()
        last = [i for i in np.flatnonzero(dones).tolist() if "terminal_observation" in infos[i]]
        if last and self._encode is not None:
            given = [infos[i]["terminal_observation"] for i in last]
            features = self._encoded(torch.stack([one["rgb"] for one in given]))
            for i, one, row in zip(last, given, features, strict=True):
                infos[i]["terminal_observation"] = {**_without_rgb(one), FEATURES: row}
        return self._seen(observation), rewards, dones, infos

    @torch.no_grad()
    def _seen(self, observation: Observations) -> Observations:
        with self._stopwatch.part("encode"):
            seen = dict(observation)
            if self._augment is not None:
                seen["rgb"] = self._augment(seen["rgb"])
            if self._mask:
                seen["segmentation"] = masked(seen["segmentation"], self._mask)
            if self._encode is not None:
                seen = {**_without_rgb(seen), FEATURES: self._encoded(seen["rgb"])}
            return seen

    @torch.no_grad()
    def _encoded(self, rgb: Tensor) -> Tensor:
        assert self._encode is not None
        return self._encode(rgb).to(torch.bfloat16)


def _without_rgb(observation: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in observation.items() if name != "rgb"}
