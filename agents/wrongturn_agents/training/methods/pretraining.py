"""How an encoder learns to see before it drives: by cars that start anywhere, off the lane and askew."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import torch
from torch import Tensor, nn

from wrongturn_agents.training.cars import Observations
from wrongturn_agents.training.checkpoint import load_weights, read, write
from wrongturn_agents.training.drives_config import DrivesConfig, PlacesConfig
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.method import Method
from wrongturn_agents.training.methods.averaging import Pool
from wrongturn_agents.training.run import Run
from wrongturn_agents.training.run_directory import ENCODER
from wrongturn_agents.training.world import cars_of

_POOL: Final = 16_384
"""Number of pictures kept at a time."""
_BEFORE: Final = 4
"""Minibatches of pictures before anything is learned."""
_STAY: Final = 64
"""Most decisions of a group of cars in a town, so that a pretraining shows all towns."""
_WARM_UP: Final = 0.1
"""Share of a pretraining over which the learning rate rises."""
_APART: Final = 20
"""Decisions between the last pictures that were learned from and those on which a pretraining is examined."""


class PretrainedMethod(Method):
    """A method whose encoder learns to see before its agent drives."""

    encoder: ClassVar[tuple[str, ...]]
    """First parts of the names of the weights in ``encoder.pt``."""

    def prepare(self, settings: Any) -> dict[str, Tensor] | None:
        """Return the weights of another run's encoder, if the settings name one."""
        path = getattr(settings, "encoder", "")
        if not path:
            return None
        found = read(Path(path), "option encoder:", "a run's encoder.pt")
        weights = found.get("state_dict") if isinstance(found, dict) else None
        if not isinstance(weights, dict) or not all(str(name).startswith(self.encoder) for name in weights):
            raise TrainingError(f"option encoder: {path} is no encoder of this method; name a run's encoder.pt")
        return weights

    def see_first(self, run: Run, module: nn.Module, learn: Callable[[], None]) -> None:
        """Give a module another run's encoder, or let it learn and save it. A resumed run has it in its state."""
        if run.state is not None:
            return
        if run.given is not None:
            load_weights(module, run.given, self.encoder, "option encoder", "name another")
        elif run.settings.pretrained:
            torch.manual_seed(run.seed)
            learn()
            weights = {name: one.cpu() for name, one in module.state_dict().items() if name.startswith(self.encoder)}
            write(run.folder / ENCODER, {"state_dict": weights})


class WanderingCars:
    """Cars that drive about at random, and show ``rgb`` and ``segmentation``.

    If the settings have traffic, all drives have the most of it: the policy cannot see what a frozen encoder never saw.
    ``journeys`` are further options of the drives, such as ``time_limit``.
    """

    def __init__(
        self, config: DrivesConfig, device: torch.device, *, seed: int, threads: int, **journeys: float
    ) -> None:
        if isinstance(config, PlacesConfig):
            config = replace(config, stay=min(config.stay, _STAY))  # type: ignore[call-arg] # mypy knows the first class
        drives = {"near_bends": 0.25, "near_junctions": 0.4, "lateral": 0.7, "yaw": 0.2, **journeys}
        self.envs: Any = cars_of(
            config, device, track="segmentation", keys=("rgb", "segmentation"), threads=threads, seed=seed,
            journeys=drives,
        )  # fmt: skip
        self._random = np.random.default_rng(seed)
        self.observation: Observations = self.envs.reset()
        self.begun = torch.ones(config.num_envs, dtype=torch.bool, device=device)
        """(n,): whether each car's picture is the first of a drive."""

    def step(self) -> Observations:
        """Drive on for 0.1 s, and return what the cars saw before."""
        before, count = self.observation, self.envs.num_envs
        actions = np.stack([self._random.normal(0.0, 0.2, count), self._random.uniform(-0.2, 0.8, count)], -1)
        self.observation, _, ended, _ = self.envs.step(actions)
        self.begun = torch.as_tensor(ended, device=self.begun.device)
        return before


def pretrain(
    run: Run, module: nn.Module, pictures: Callable[[], dict[str, Tensor]], loss_of: Callable[[Any], Tensor]
) -> None:
    """Teach a module to see while pictures are rendered, and write ``pretraining.json``.

    ``pictures`` renders the next pictures of all cars, (n, ...) each; ``loss_of`` returns the loss of a minibatch of
    them. The learning rate rises and falls by the share that is over. The module is in evaluation mode afterwards.

    Raises:
        TrainingError: There is no time for a minibatch.
    """
    config, budget, device = run.settings, run.budget, run.device
    frames, batch = config.pretraining_frames, config.pretraining_batch
    seconds = 60.0 * config.pretraining_minutes
    total = max(1, round(frames * config.pretraining_passes / batch))
    weights = [parameter for parameter in module.parameters() if parameter.requires_grad]
    optimizer = torch.optim.AdamW(weights, lr=config.pretraining_rate, fused=device.type == "cuda")
    precision = torch.autocast(device.type, torch.bfloat16, enabled=config.bf16 and device.type == "cuda")
    pool = Pool(max(min(_POOL, frames), config.num_envs))
    pool.add(pictures())
    done, rendered, begin = 0, config.num_envs, budget.used  # the first pictures take as long as compiling does

    def share() -> float:
        return 1.0 if budget.over() else max(done / total, (budget.used - begin) / seconds)

    module.train()
    while share() < 1.0:
        if rendered < frames:
            pool.add(pictures())
            rendered += config.num_envs
        due = total if rendered >= frames else total * rendered // frames
        if len(pool) < min(pool.size, _BEFORE * batch):
            continue
        while done < due and (over := share()) < 1.0:
            for group in optimizer.param_groups:
                group["lr"] = config.pretraining_rate * _risen(over)
            with precision:
                loss = loss_of(pool.draw(batch))
            optimizer.zero_grad(set_to_none=True)
            torch.autograd.backward(loss)
            optimizer.step()
            done += 1
            if done % 50 == 0:
                run.on_note(f"pretraining, {rendered:,} frames, loss {loss.item():.3f}")
    if not done:
        raise TrainingError(
            "pretraining: there is no time for a minibatch; give more --minutes, more pretraining_minutes, or another "
            "run's encoder (--option encoder=runs/ppo-image-1/encoder.pt)"
        )
    module.eval()
    with torch.no_grad(), precision:
        for _ in range(_APART):
            unseen = pictures()
        loss = loss_of({name: rows[:batch] for name, rows in unseen.items()})
    found = {"frames": rendered, "minibatches": done, "loss": loss.item()}
    (run.folder / "pretraining.json").write_text(json.dumps(found, indent=1) + "\n", "utf-8")


def _risen(over: float) -> float:
    """Return the share of the greatest learning rate: it rises, then falls by a half cosine."""
    if over < _WARM_UP:
        return max(over / _WARM_UP, 0.01)
    return max(0.5 * (1.0 + math.cos(math.pi * (over - _WARM_UP) / (1.0 - _WARM_UP))), 0.01)
