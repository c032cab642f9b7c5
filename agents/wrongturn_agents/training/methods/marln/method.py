"""MaRLn as a training method: affordances first, then Rainbow-IQN on the frozen encoder."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import torch

from wrongturn_agents.models.marln import Marln
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.cars import training_cars
from wrongturn_agents.training.checkpoint import read_encoder, take_encoder, write
from wrongturn_agents.training.method import Method, TrainedAgent
from wrongturn_agents.training.methods.marln.cars import Cars
from wrongturn_agents.training.methods.marln.config import MarlnConfig
from wrongturn_agents.training.methods.marln.learning import Learned, Learner
from wrongturn_agents.training.methods.marln.pretraining import pretrain
from wrongturn_agents.training.methods.marln.replay import Replay
from wrongturn_agents.training.run import Run
from wrongturn_agents.training.run_directory import ENCODER

_ROW: Final = 64
"""Decisions of each car between two rows of ``progress.csv``."""
_ENCODER: Final = ("network.", "affordances.")


class MarlnMethod(Method):
    """MaRLn (Toromanoff et al., CVPR 2020)."""

    settings = MarlnConfig
    agents = (
        TrainedAgent(
            "marln", SHIPPED_AGENTS["marln"].track, MarlnConfig.keys, SHIPPED_AGENTS["marln"].description
        ),
    )  # fmt: skip

    def build(self, settings: MarlnConfig, algorithm: str = "marln", *, seed: int | None = None) -> Marln:  # noqa: ARG002
        """Return the untrained network."""
        with torch.random.fork_rng(devices=[], enabled=seed is not None):
            if seed is not None:
                torch.manual_seed(seed)
            model = Marln(hidden=settings.hidden, deviation=settings.noise)
        model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return model

    def spare(self, weight: str) -> bool:
        """Return whether a weight is of the affordances' heads or of the noise."""
        return weight.startswith("affordances.") or "deviation" in weight

    def prepare(self, settings: MarlnConfig) -> dict[str, torch.Tensor] | None:
        """Return the weights of another run's encoder, if the settings name one."""
        return read_encoder(Path(settings.encoder), _ENCODER) if settings.encoder else None

    def learn(self, run: Run) -> None:
        """Pretrain the encoder, then drive and learn."""
        config: MarlnConfig = run.settings
        model = self.build(config, seed=run.seed).to(run.device)
        resumed = run.only_pretrained or run.state is not None
        encoder = read_encoder(run.folder / ENCODER, _ENCODER) if resumed else run.given
        if encoder is not None:
            take_encoder(model, encoder, _ENCODER)
        elif config.pretrained:
            torch.manual_seed(run.seed)
            found = pretrain(
                model, config, device=run.device, seed=run.stream(0), budget=run.budget, threads=run.threads,
                on_note=run.on_note,
            )  # fmt: skip
            (run.folder / "pretraining.json").write_text(json.dumps(asdict(found), indent=1) + "\n", "utf-8")
        model.eval()
        for part in (model.network, model.affordances):
            part.requires_grad_(False)
        if run.state is None:
            weights = {name: one.cpu() for name, one in model.state_dict().items() if name.startswith(_ENCODER)}
            write(run.folder / ENCODER, {"state_dict": weights, "seconds": run.budget.used})
        _drive(run, config, model)


METHOD: Final = MarlnMethod()


def _drive(run: Run, config: MarlnConfig, model: Marln) -> None:
    """Drive and learn until the budget is over. A resumed run fills its replay memory anew."""
    stream = run.stream(run.steps)
    generator = torch.Generator(run.device).manual_seed(stream)
    learner = Learner(model.values, config, generator)
    if run.state is not None:
        _restore(learner, generator, run)
    run.begin(model, lambda: _state_of(learner, generator))
    envs = training_cars(None, run.device, settings=config, threads=run.threads, stopwatch=run.stopwatch, seed=stream)
    try:
        cars = Cars(envs, model, config, run.stopwatch, generator)
        replay = Replay(
            config.replay_size,
            config.num_envs,
            model.width,
            n_step=config.n_step,
            gamma=config.gamma,
            exponent=config.priority_exponent,
            device=run.device,
        )
        steps, rows, due = run.steps, 0, 0.0
        learned: list[Learned] = []
        while not run.over(steps):
            decisions, ended = cars.drive()
            with run.stopwatch.part("buffer"):
                replay.add(decisions)
            run.drove(ended)
            steps, rows = steps + config.num_envs, rows + 1
            if steps - run.steps >= config.learn_after:
                due += config.replay_ratio * config.num_envs / config.batch_size
                with run.stopwatch.part("learn"):
                    while due >= 1.0:
                        learned.append(learner.update(replay, run.budget.fraction(steps)))
                        due -= 1.0
            if rows % _ROW == 0:
                run.tick(steps, **_figures(learner, learned))
                learned.clear()
        run.finish(steps, **_figures(learner, learned))
    finally:
        envs.close()


def _figures(learner: Learner, learned: list[Learned]) -> dict[str, Any]:
    found = {"learning_rate": learner.optimizer.param_groups[0]["lr"], "minibatches": len(learned)}
    if learned:
        found["value_loss"] = float(torch.stack([one.loss for one in learned]).mean())
    return found


def _state_of(learner: Learner, generator: torch.Generator) -> dict[str, Any]:
    return {
        "updates": learner.updates,
        "values": learner.values.state_dict(),
        "target": learner.target.state_dict(),
        "optimizer": learner.optimizer.state_dict(),
        "generator": generator.get_state(),
    }


def _restore(learner: Learner, generator: torch.Generator, run: Run) -> None:
    with run.restoring() as state:
        learner.values.load_state_dict(state["values"])
        learner.target.load_state_dict(state["target"])
        learner.optimizer.load_state_dict(state["optimizer"])
        learner.updates = state["updates"]
        generator.set_state(state["generator"])
