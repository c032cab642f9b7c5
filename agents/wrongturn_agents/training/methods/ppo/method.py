"""The paper's three agents as training methods."""

from typing import Any, Final

import torch
from stable_baselines3.common.callbacks import BaseCallback

from wrongturn_agents.models import ActorCritic, build
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.method import TrainedAgent
from wrongturn_agents.training.methods.ppo.config import AuxiliaryConfig, ImageConfig, PPOConfig, SegmentationConfig
from wrongturn_agents.training.methods.ppo.ppo import WrongturnPPO
from wrongturn_agents.training.methods.ppo.rollout import SeenVecEnv
from wrongturn_agents.training.methods.pretraining import PretrainedMethod, WanderingCars, pretrain
from wrongturn_agents.training.run import Run
from wrongturn_agents.training.world import cars_of
from wrongturn_protocol import Track

_WARMING: Final = 40
"""Batches from which batch normalisation learns its first statistics."""


class PPOMethod(PretrainedMethod):
    """PPO with one of the paper's networks."""

    encoder = ("network.", "decoder.")

    def __init__(self, settings: type[PPOConfig]) -> None:
        self.settings = settings
        shipped = SHIPPED_AGENTS[settings.algorithm]
        seen = "segmentation" if shipped.track is Track.SEGMENTATION else "rgb"
        keys = ("speed", "steering", "command", seen)
        self.agents = (TrainedAgent(shipped.name, shipped.track, keys, shipped.description),)

    def build(self, settings: PPOConfig, algorithm: str) -> ActorCritic:
        """Return the untrained networks."""
        more: dict[str, Any] = {}
        if isinstance(settings, SegmentationConfig):
            more["masked_classes"] = settings.masked_classes
        if isinstance(settings, ImageConfig):
            more["frozen"] = settings.pretrained
        if isinstance(settings, ImageConfig | AuxiliaryConfig):
            more["projection"] = settings.projection
        agent = build(algorithm, activation=settings.activation, **more)
        with torch.no_grad():
            agent.branches.policy.bias[..., 1] = settings.accelerate
        return agent

    def learn(self, run: Run) -> None:
        """Pretrain the encoder, if the agent has a frozen one; then drive and learn."""
        config: PPOConfig = run.settings
        agent = self.build(config, self.name).to(run.device)
        self.see_first(run, agent.encoder, lambda: _learn_to_segment(run, agent))
        cars = cars_of(config, run.device, threads=run.threads)
        envs = SeenVecEnv(cars, agent, config)
        seed = run.stream(run.steps)
        model = WrongturnPPO(config, envs, agent, run.budget, seed=seed, device=run.device)
        model.set_logger(run.logger)
        if run.state is not None:
            _restore(model, run)
        elif config.statistics:
            _warm(model, envs)
        run.begin(agent, lambda: _state_of(model))
        try:
            model.learn(
                run.budget.steps - run.steps,
                callback=_Reports(run),
                log_interval=None,
                reset_num_timesteps=run.state is None,
            )
        finally:
            envs.close()


SEGMENTATION: Final = PPOMethod(SegmentationConfig)
IMAGE: Final = PPOMethod(ImageConfig)
AUXILIARY: Final = PPOMethod(AuxiliaryConfig)


class _Reports(BaseCallback):
    """Tells the run how far it is, and ends it in time."""

    model: WrongturnPPO

    def __init__(self, run: Run) -> None:
        super().__init__()
        self._run = run
        self._row_at = run.steps

    def _on_step(self) -> bool:
        self._run.drove(self.locals["infos"])
        return not self.model.budget.over()

    def _on_rollout_end(self) -> None:
        """Consider the agent that drove as a candidate, before an update changes it."""
        self._run.consider(max(0, self.model.num_timesteps - self.model.n_steps * self.model.n_envs))

    def _on_rollout_start(self) -> None:
        """Report what was learned from the last rollout."""
        if self.model.num_timesteps != self._row_at:
            self._row_at = self.model.num_timesteps
            self._run.tick(self.model.num_timesteps, **self.model.figures)

    def _on_training_end(self) -> None:
        self._run.finish(self.model.num_timesteps, **self.model.figures)


def _learn_to_segment(run: Run, agent: ActorCritic) -> None:
    """Teach the encoder segmentation, together with a decoder that is not used afterwards, and freeze it."""
    encoder: Any = agent.encoder
    cars = WanderingCars(run.settings, run.device, seed=run.stream(0), threads=run.threads, time_limit=1.0)
    encoder.freeze(False)
    augment = run.settings.augment
    pretrain(run, agent, cars.step, lambda drawn: agent.segmentation_loss(drawn, augment=augment))
    encoder.freeze()
    cars.envs.close()


def _warm(model: WrongturnPPO, envs: SeenVecEnv) -> None:
    """Let batch normalisation see random drives before the policy drives."""
    observation = envs.reset()
    for _ in range(_WARMING):
        with model.policy.precision(observation):
            model.policy.model.update_statistics(observation)
        actions, _, _ = model.policy(observation)
        observation = envs.step(actions.detach().cpu().numpy())[0]


def _state_of(model: WrongturnPPO) -> dict[str, Any]:
    return {
        "updates": model._n_updates,
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "torch": torch.get_rng_state(),
        "cuda": torch.cuda.get_rng_state_all() if model.device.type == "cuda" else [],
        "caution": model.caution,
    }


def _restore(model: WrongturnPPO, run: Run) -> None:
    with run.restoring() as state:
        model.policy.load_state_dict(state["policy"])
        model.policy.optimizer.load_state_dict(state["optimizer"])
        model.num_timesteps = run.steps
        model._n_updates = state["updates"]
        model.caution = state["caution"]
        model._current_progress_remaining = 1.0 - model.budget.fraction(run.steps)
        torch.set_rng_state(state["torch"])
        if state["cuda"] and model.device.type == "cuda":
            torch.cuda.set_rng_state_all(state["cuda"])
