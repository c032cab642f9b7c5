"""PPO (Schulman et al. 2017) from Stable-Baselines3, with the paper's auxiliary loss."""

import copy
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.type_aliases import DictRolloutBufferSamples
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor
from torch.nn import functional

from wrongturn_agents.models import ActorCritic
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.cars import Observations
from wrongturn_agents.training.methods.ppo.config import PPOConfig
from wrongturn_agents.training.methods.ppo.policy import WrongturnPolicy
from wrongturn_agents.training.methods.ppo.rollout import DeviceRolloutBuffer

_LEAST_CAUTION = 1.0 / 64
_OPTIONS = (
    *("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef", "vf_coef", "max_grad_norm"),
)
"""Settings that are Stable-Baselines3's own options."""


class WrongturnPPO(PPO):
    """Stable-Baselines3's PPO with its own loop over minibatches.

    The loop is different for four reasons:

    - The segmentation loss joins PPO's loss (the paper's equation for l).
    - A run's budget is also checked between minibatches.
    - Only the divergence is fetched from the device, once for each minibatch.
    - An update that changes the policy beyond recognition is undone.

    A single step of Adam can do the last to a ResNet whose batch normalisation uses running statistics. After such an
    update the learning rate is halved, and recovers over the next dozens of updates. It also falls as the budget is
    used up.
    """

    policy: WrongturnPolicy

    def __init__(self, config: PPOConfig, env: VecEnv, agent: ActorCritic, budget: Budget, **more: Any) -> None:
        self.config = config
        self.budget = budget
        self.figures: dict[str, float] = {}
        """Figures of the last update, by name."""
        self.caution = 1.0
        """Factor of the learning rate; below 1 after updates that were undone."""

        def learning_rate(remaining: float) -> float:
            left = config.final_learning_rate
            return config.learning_rate * (left + (1.0 - left) * remaining)

        super().__init__(
            WrongturnPolicy,
            env,
            learning_rate=learning_rate,
            **{name: getattr(config, name) for name in _OPTIONS},
            target_kl=config.kl_stop,
            rollout_buffer_class=DeviceRolloutBuffer,
            policy_kwargs={"model": lambda: agent, "config": config},
            **more,
        )

    @staticmethod
    def _wrap_env(env: VecEnv, verbose: int = 0, monitor_wrapper: bool = True) -> VecEnv:  # noqa: ARG004
        """Return the environments unchanged: Stable-Baselines3 would transpose pictures in numpy."""
        return env

    def _update_current_progress_remaining(self, num_timesteps: int, total_timesteps: int) -> None:  # noqa: ARG002
        self._current_progress_remaining = 1.0 - self.budget.fraction(num_timesteps)

    def _update_learning_rate(self, optimizers: Any) -> None:
        """Set each parameter group's share of the scheduled learning rate."""
        rate = self.caution * self.lr_schedule(self._current_progress_remaining)
        for group in optimizers.param_groups:
            group["lr"] = rate * group["share"]

    def train(self) -> None:
        """Learn from the rollout."""
        policy, config = self.policy, self.config
        policy.set_training_mode(True)
        self._update_learning_rate(policy.optimizer)
        before = copy.deepcopy((policy.state_dict(), policy.optimizer.state_dict()))
        trained = [parameter for group in policy.optimizer.param_groups for parameter in group["params"]]
        sums: dict[str, Tensor] = {}
        batches = epochs = 0
        divergence, stopped = 0.0, False
        for _ in range(config.n_epochs):
            for samples in self.rollout_buffer.get(config.batch_size):
                loss, terms, divergences = self._loss(samples)
                divergence = divergences.item()
                # 1.5 times the limit, as in Stable-Baselines3, because one minibatch's estimate is noisy.
                stopped = not divergence <= 1.5 * config.kl_stop or self.budget.over()
                if stopped:
                    break
                policy.optimizer.zero_grad(set_to_none=True)
                torch.autograd.backward(loss)
                torch.nn.utils.clip_grad_norm_(trained, config.max_grad_norm)
                policy.optimizer.step()
                batches += 1
                for name, term in terms.items():
                    sums[name] = sums.get(name, torch.zeros_like(term)) + term
            if stopped:
                break
            epochs += 1
            self._n_updates += 1
        if not self._too_far(divergence):
            divergence = self._final_divergence()
        reverted = self._too_far(divergence)
        if reverted:
            policy.load_state_dict(before[0])
            policy.optimizer.load_state_dict(before[1])
        self.caution = max(_LEAST_CAUTION, 0.5 * self.caution) if reverted else min(1.0, 1.03 * self.caution)
        buffer = self.rollout_buffer
        unexplained = (buffer.returns - buffer.values).var() / buffer.returns.var().clamp_min(1e-8)
        steer, accelerate = policy.model.log_std.detach().exp().tolist()
        self.figures = {
            "divergence": divergence,
            "reverted": float(reverted),
            "epochs": float(epochs),
            "minibatches": float(batches),
            "explained_variance": 1.0 - unexplained.item(),
            "std_steer": steer,
            "std_accelerate": accelerate,
            "learning_rate": policy.optimizer.param_groups[0]["lr"],
            **{name: (term / max(batches, 1)).item() for name, term in sums.items()},
        }

    def _too_far(self, divergence: float) -> bool:
        return not divergence <= self.config.kl_revert * abs(self.config.kl_stop)

    @torch.no_grad()
    def _final_divergence(self) -> float:
        """Return the divergence of the policy that will drive next, with its new statistics."""
        samples = next(self.rollout_buffer.get(self.config.batch_size))
        if self.config.statistics:
            with self.policy.precision(samples.observations):
                self.policy.model.update_statistics(samples.observations)
        _, log_prob, _ = self.policy.evaluate_actions(samples.observations, samples.actions)
        return _divergence(log_prob - samples.old_log_prob).item()

    def _loss(self, samples: DictRolloutBufferSamples) -> tuple[Tensor, dict[str, Tensor], Tensor]:
        """Return a minibatch's loss, its terms, and the divergence from the policy that drove."""
        config = self.config
        values, log_prob, entropy = self.policy.evaluate_actions(samples.observations, samples.actions)
        advantages = samples.advantages
        advantages = (advantages - advantages.mean()) / (advantages.std() + 1e-8)
        log_ratio = log_prob - samples.old_log_prob
        ratio = log_ratio.exp()
        clipped = ratio.clamp(1.0 - config.clip_range, 1.0 + config.clip_range)
        policy_loss = -torch.min(advantages * ratio, advantages * clipped).mean()
        value_loss = functional.mse_loss(values.flatten(), samples.returns)
        loss = policy_loss + config.vf_coef * value_loss - config.ent_coef * entropy
        with torch.no_grad():
            divergence = _divergence(log_ratio)
            outside = ((ratio - 1.0).abs() > config.clip_range).float().mean()
        terms = {"policy_loss": policy_loss, "value_loss": value_loss, "clip_fraction": outside}
        if config.auxiliary:
            auxiliary = self._auxiliary_loss(samples.observations)
            loss = self.policy.homoscedastic(loss, auxiliary)
            terms["auxiliary_loss"] = auxiliary
        return loss, {name: term.detach() for name, term in terms.items()}, divergence

    def _auxiliary_loss(self, observations: Observations) -> Tensor:
        """Return the cross-entropy of the predicted segmentation for the first frames of a minibatch."""
        count = max(1, round(self.config.auxiliary_share * len(observations["speed"])))
        chosen = {name: tensor[:count] for name, tensor in observations.items()}
        with self.policy.precision(chosen):
            loss: Tensor = self.policy.model.segmentation_loss(chosen)
        return loss


def _divergence(log_ratio: Tensor) -> Tensor:
    """Return Schulman's low-variance estimate of the divergence, ()."""
    return (log_ratio.exp() - 1.0 - log_ratio).mean()
