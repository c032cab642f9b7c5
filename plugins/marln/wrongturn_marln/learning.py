"""Rainbow-IQN: double Q-learning of quantiles, from replayed returns of n steps."""

import copy
from typing import Any

import torch
from torch import Tensor

from wrongturn_marln.config import MarlnConfig
from wrongturn_marln.network import ValueNetwork
from wrongturn_marln.quantiles import quantile_huber
from wrongturn_marln.replay import Replay, Sample


class Learner:
    """Trains the layers behind the frozen encoder. The generator, on their device, is for shares and noise."""

    def __init__(self, values: ValueNetwork, config: MarlnConfig, generator: torch.Generator) -> None:
        self.values, self.config, self._generator = values, config, generator
        self.target = copy.deepcopy(values).requires_grad_(False)
        self._trained = list(values.parameters())
        projection = list(values.projection.parameters())
        others = [one for name, one in values.named_parameters() if not name.startswith("projection.")]
        self.optimizer = torch.optim.Adam(
            [{"params": others, "share": 1.0}, {"params": projection, "share": config.projection_learning_rate}],
            lr=config.learning_rate,
            eps=config.adam_epsilon,
            fused=generator.device.type == "cuda",  # one kernel for all weights
        )
        self.updates = 0

    def update(self, replay: Replay, fraction: float) -> Tensor:
        """Learn from one minibatch, and return its loss. ``fraction`` is how much of the run is over, from 0 to 1."""
        config = self.config
        weight = config.priority_weight + (1.0 - config.priority_weight) * fraction
        sample = replay.sample(config.batch_size, weight, self._generator)
        left = config.final_learning_rate
        for group in self.optimizer.param_groups:
            group["lr"] = group["share"] * config.learning_rate * (left + (1.0 - left) * (1.0 - fraction))
        losses = self.losses(sample)
        self.optimizer.zero_grad(set_to_none=True)
        loss = (sample.weight * losses).mean()
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(self._trained, config.max_grad_norm)
        self.optimizer.step()
        replay.update(sample.places, losses)
        self.updates += 1
        if self.updates % config.target_every == 0:
            self.target.load_state_dict(self.values.state_dict())
        return loss.detach()

    def losses(self, sample: Sample) -> Tensor:
        """Return each decision's loss (b,), not weighted."""
        rows, values = len(sample.places), self.values
        wanted = self.wanted(sample)
        shares = self._shares(rows, self.config.quantiles)
        noise = values.heads.draw_noise(rows, self._generator)
        quantiles = values(*sample.now[:3], shares, noise)
        found = _of_action(quantiles, sample.now.action)
        return quantile_huber(found, wanted, shares, self.config.kappa)

    @torch.no_grad()
    def wanted(self, sample: Sample) -> Tensor:
        """Return samples of the target (b, N'): the network chooses what follows, the target network values it."""
        rows, count = len(sample.now.action), self.config.target_quantiles
        quantiles = []
        for network in (self.values, self.target):
            noise = network.heads.draw_noise(rows, self._generator)
            shares = self._shares(rows, count)
            quantiles.append(network(*sample.later[:3], shares, noise))
        following = _of_action(quantiles[1], quantiles[0].mean(1).argmax(1))
        return sample.returns.unsqueeze(1) + sample.following.unsqueeze(1) * following

    def state_dict(self) -> dict[str, Any]:
        """Return all that :meth:`load_state_dict` needs beside the network."""
        return {
            "updates": self.updates,
            "target": self.target.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "generator": self._generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a run's state."""
        self.target.load_state_dict(state["target"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.updates = state["updates"]
        self._generator.set_state(state["generator"])

    def _shares(self, rows: int, count: int) -> Tensor:
        return torch.rand(rows, count, device=self._generator.device, generator=self._generator)


def _of_action(quantiles: Tensor, action: Tensor) -> Tensor:
    """Return the quantiles (b, N) of each row's action, of those of all actions (b, N, actions)."""
    return quantiles.gather(2, action.view(-1, 1, 1).expand(-1, quantiles.shape[1], 1)).squeeze(2)
