"""MaRLn's network: untrained from its settings, or with the weights of a checkpoint."""

from typing import Any

import torch

from wrongturn_agents.models.marln import Marln
from wrongturn_agents.training.checkpoint import load_weights
from wrongturn_agents.training.config import config_of
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.marln.config import MarlnConfig


def build_marln(config: MarlnConfig, seed: int | None = None) -> Marln:
    """Return the untrained network of a configuration, on the CPU."""
    with torch.random.fork_rng(devices=[], enabled=seed is not None):
        if seed is not None:
            torch.manual_seed(seed)
        model = Marln(hidden=config.hidden, deviation=config.noise)
    model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return model


def marln_of(checkpoint: dict[str, Any], device: torch.device | str = "cpu") -> Marln:
    """Build the agent of a loaded checkpoint, ready to drive.

    A checkpoint may lack what only learning needs: the heads of the affordances, and the noise.

    Raises:
        TrainingError: its weights do not fit this version's network, or are not finite.
    """
    config = config_of(checkpoint["algorithm"], checkpoint["config"])
    if not isinstance(config, MarlnConfig):
        raise TrainingError(f"checkpoint: is of {checkpoint['algorithm']}, not of marln; name a run of marln")
    model = build_marln(config)
    load_weights(model, checkpoint["state_dict"], lambda name: name.startswith("affordances.") or "deviation" in name)
    return model.to(device).eval()
