"""The paper's three agents as training methods."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch
from stable_baselines3.common.callbacks import BaseCallback

from wrongturn_agents.models import ActorCritic, build
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.cars import training_cars
from wrongturn_agents.training.checkpoint import read_encoder, take_encoder, write
from wrongturn_agents.training.driving_env import Observations
from wrongturn_agents.training.method import Method, TrainedAgent
from wrongturn_agents.training.methods.ppo.config import AuxiliaryConfig, ImageConfig, PPOConfig, SegmentationConfig
from wrongturn_agents.training.methods.ppo.ppo import WrongturnPPO
from wrongturn_agents.training.methods.ppo.pretrain import pretrain
from wrongturn_agents.training.methods.ppo.seen_env import SeenVecEnv
from wrongturn_agents.training.run import Run
from wrongturn_agents.training.run_directory import ENCODER
from wrongturn_agents.training.stopwatch import Stopwatch
from wrongturn_protocol import Track

_ENCODER: Final = ("network.", "decoder.")
_UNDRIVEN: Final = ("encoder.decoder.", "encoder.segmenting.")
_WARMING: Final = 40
"""Batches from which batch normalisation learns its first statistics."""


class PPOMethod(Method):
    """PPO with one of the paper's networks."""

    def __init__(self, settings: type[PPOConfig]) -> None:
        self.settings = settings
        shipped = SHIPPED_AGENTS[settings.algorithm]
        seen = "segmentation" if shipped.track is Track.SEGMENTATION else "rgb"
        keys = ("speed", "steering", "command", seen)
        self.agents = (TrainedAgent(shipped.name, shipped.track, keys, shipped.description),)

    def build(self, settings: PPOConfig, algorithm: str, *, seed: int | None = None) -> ActorCritic:
        """Return the untrained networks."""
        more: dict[str, Any] = {}
        if isinstance(settings, SegmentationConfig):
            more["masked_classes"] = settings.masked_classes
        if isinstance(settings, ImageConfig):
            more["frozen"] = settings.frozen
        agent = build(algorithm, seed=seed, activation=settings.activation, **more)
        with torch.no_grad():
            agent.branches.policy.bias[..., 1] = settings.accelerate
        return agent

    def spare(self, weight: str) -> bool:
        """Return whether a weight is a decoder's, which only learning needs."""
        return weight.startswith(_UNDRIVEN)

    def load(self, told: Any, settings: Any, device: torch.device | str = "cpu") -> Any:
        """Return the agent of a checkpoint. The first checkpoints do not name their activation: it was ReLU."""
        if "activation" not in told["config"]:
            settings = self.settings.of({**told["config"], "activation": "relu"})
        return super().load(told, settings, device)

    def prepare(self, settings: PPOConfig) -> dict[str, torch.Tensor] | None:
        """Return the weights of another run's encoder, if the settings name one."""
        path = getattr(settings, "encoder", "")
        return read_encoder(Path(path), _ENCODER) if path else None

    def learn(self, run: Run) -> None:
        """Pretrain the encoder, if the agent has a frozen one; then drive and learn."""
        config: PPOConfig = run.settings
        agent = self.build(config, self.name, seed=run.seed).to(run.device)
        encoder = read_encoder(run.folder / ENCODER, _ENCODER) if run.only_pretrained else run.given
        if encoder is not None:
            take_encoder(agent.encoder, encoder, _ENCODER)
        elif isinstance(config, ImageConfig) and config.pretrained and run.state is None:
            _pretrain(agent, config, run)
        envs = cars_seen_by(agent, config, run.stopwatch, threads=run.threads)
        model = WrongturnPPO(
            config,
            envs,
            model=lambda: agent,
            budget=run.budget,
            stopwatch=run.stopwatch,
            seed=run.stream(run.steps),
            device=run.device,
        )
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


def cars_seen_by(agent: ActorCritic, config: PPOConfig, stopwatch: Stopwatch, *, threads: int) -> SeenVecEnv:
    """Make the training's cars as the agent sees them.

    Args:
        agent: agent on the device of the pictures. It augments them, and encodes them if its encoder is frozen.
        config: number of cars, their starts, traffic and rewards.
        stopwatch: counts the environments, the pictures and the frozen encoder.
        threads: threads that share the simulation.
    """
    device = agent.log_std.device

    def encode(observation: Observations) -> torch.Tensor:
        with torch.autocast(device.type, torch.bfloat16, enabled=config.bf16 and device.type == "cuda"):
            return agent.encode(observation)

    return SeenVecEnv(
        training_cars(None, device, settings=config, threads=threads, stopwatch=stopwatch),
        disturb=agent.disturb if config.disturbed else None,
        encode=encode if config.frozen else None,
        width=agent.encoder.width,
        stopwatch=stopwatch,
    )


def _pretrain(agent: ActorCritic, config: ImageConfig, run: Run) -> None:
    """Pretrain the encoder, and save it for other runs."""
    torch.manual_seed(run.seed)
    found = pretrain(
        agent, config, device=run.device, seed=run.seed, budget=run.budget, threads=run.threads, on_note=run.on_note
    )
    weights = {name: tensor.detach().cpu() for name, tensor in agent.encoder.state_dict().items()}
    weights = {name: tensor for name, tensor in weights.items() if name.startswith(_ENCODER)}
    write(run.folder / ENCODER, {"state_dict": weights, "seconds": run.budget.used, **asdict(found)})
    (run.folder / "pretraining.json").write_text(json.dumps(asdict(found), indent=1) + "\n", "utf-8")


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
