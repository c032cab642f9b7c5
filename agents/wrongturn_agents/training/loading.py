"""Trained agents of all algorithms, from their checkpoints, ready to be scored."""

from dataclasses import dataclass
from pathlib import Path

import torch

from wrongturn_agents.training.checkpoint import load_checkpoint, model_of
from wrongturn_agents.training.config import config_of
from wrongturn_agents.training.drive import AnyModel
from wrongturn_agents.training.lbc.checkpoints import is_lbc, load_agent
from wrongturn_agents.training.lbc.config import PRIVILEGED, LBCConfig
from wrongturn_agents.training.marln.config import MarlnConfig
from wrongturn_agents.training.marln.network import marln_of
from wrongturn_protocol import Track


@dataclass(frozen=True)
class Loaded:
    """An agent from its checkpoint."""

    model: AnyModel
    track: Track
    """Track whose observations it needs."""
    algorithm: str
    seed: int
    variant: str | None
    """Name of the ablation; None for the unchanged algorithm."""
    steps: int


def load(checkpoint: Path | str, device: torch.device | str = "cpu") -> Loaded:
    """Load an agent from a checkpoint of ``wrongturn train``.

    Raises:
        TrainingError: the file is missing, damaged, or no checkpoint of an agent that drives by itself.
    """
    if is_lbc(checkpoint):
        agent, told = load_agent(checkpoint, device)
        privileged = told["algorithm"] == PRIVILEGED
        variant = None if privileged else LBCConfig.of(told["config"]).variant
        track = Track.PRIVILEGED if privileged else Track.CAMERA
        return Loaded(agent, track, told["algorithm"], told["seed"], variant, told["steps"])
    found = load_checkpoint(checkpoint)
    config = config_of(found["algorithm"], found["config"])
    segmented = config.track == "segmentation" and "rgb" not in config.keys
    track = Track.SEGMENTATION if segmented else Track.CAMERA
    model = marln_of(found, device) if isinstance(config, MarlnConfig) else model_of(found, device)
    return Loaded(model, track, found["algorithm"], found["seed"], config.variant, found["steps"])
