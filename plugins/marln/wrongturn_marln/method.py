"""MaRLn as a training method: affordances first, then Rainbow-IQN on the frozen encoder."""

from typing import Any, Final

import torch
from torch import Tensor, nn

from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.method import TrainedAgent
from wrongturn_agents.training.methods.pretraining import PretrainedMethod, WanderingCars, pretrain
from wrongturn_agents.training.run import Run
from wrongturn_agents.training.world import cars_of
from wrongturn_marln.affordances import Affordances
from wrongturn_marln.cars import Cars, FrameStack
from wrongturn_marln.config import MarlnConfig
from wrongturn_marln.learning import Learner
from wrongturn_marln.network import Marln, disturb
from wrongturn_marln.replay import Replay
from wrongturn_marln.truth import RoadTruths

_ROW: Final = 64
"""Decisions of each car between two rows of ``progress.csv``."""


class MarlnMethod(PretrainedMethod):
    """MaRLn (Toromanoff et al., CVPR 2020)."""

    settings = MarlnConfig
    encoder = ("network.", "affordances.")
    agents = (
        TrainedAgent(
            "marln", SHIPPED_AGENTS["marln"].track, MarlnConfig.keys, SHIPPED_AGENTS["marln"].description
        ),
    )  # fmt: skip

    def build(self, settings: MarlnConfig, algorithm: str) -> Marln:  # noqa: ARG002
        """Return the untrained network."""
        model = Marln(hidden=settings.hidden, deviation=settings.noise)
        model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return model

    def learn(self, run: Run) -> None:
        """Pretrain the encoder, then drive and learn until the budget is over. A resumed run fills its memory anew."""
        config: MarlnConfig = run.settings
        model = self.build(config, self.name).to(run.device)
        self.see_first(run, model, lambda: _learn_affordances(run, model))
        model.eval()
        for part in (model.network, model.affordances):
            part.requires_grad_(False)
        stream = run.stream(run.steps)
        generator = torch.Generator(run.device).manual_seed(stream)
        learner = Learner(model.values, config, generator)
        if run.state is not None:
            with run.restoring() as state:
                model.load_state_dict(state["model"])
                learner.load_state_dict(state)
        run.begin(model, lambda: {"model": model.state_dict(), **learner.state_dict()})
        envs = cars_of(config, run.device, threads=run.threads, seed=stream)
        try:
            _drive(run, learner, Cars(envs, model, config, generator), model.width)
        finally:
            envs.close()


METHOD: Final = MarlnMethod()


def _learn_affordances(run: Run, model: Marln) -> None:
    """Teach the encoder affordances on stacks of pictures, with heads that are not used afterwards."""
    seed = run.stream(0)
    cars = WanderingCars(run.settings, run.device, seed=seed, threads=run.threads, inside_junctions=0.1, time_limit=1.5)
    stack, truth = FrameStack(), RoadTruths()
    parts = nn.ModuleList([model.network, model.affordances])

    def pictures() -> dict[str, Tensor]:
        frames = stack.push(cars.observation["rgb"], cars.begun)
        told = truth.of(cars.envs.poses_by_town, run.device)._asdict()
        return {"frames": frames, "segmentation": cars.step()["segmentation"], **told}

    def loss_of(drawn: dict[str, Tensor]) -> Tensor:
        frames = disturb(model.augmentation, drawn["frames"]) if run.settings.augment else drawn["frames"]
        seen = model.learn_to_see(frames) if parts.training else model.see(frames)
        told = Affordances(*(drawn[name] for name in Affordances._fields))
        return model.affordances.loss(seen, drawn["segmentation"], told)

    pretrain(run, parts, pictures, loss_of)
    cars.envs.close()


def _drive(run: Run, learner: Learner, cars: Cars, width: int) -> None:
    """Drive and learn until the budget is over."""
    config: MarlnConfig = run.settings
    replay = Replay(
        config.replay_size,
        config.num_envs,
        width,
        n_step=config.n_step,
        gamma=config.gamma,
        exponent=config.priority_exponent,
        device=run.device,
    )
    steps, rows, due = run.steps, 0, 0.0
    losses: list[Tensor] = []

    def figures() -> dict[str, Any]:
        found = {"learning_rate": learner.optimizer.param_groups[0]["lr"], "minibatches": len(losses)}
        return found | ({"value_loss": torch.stack(losses).mean().item()} if losses else {})

    while not run.over(steps):
        decisions, ended = cars.drive()
        replay.add(decisions)
        run.drove(ended)
        steps, rows = steps + config.num_envs, rows + 1
        if steps - run.steps >= config.learn_after:
            due += config.replay_ratio * config.num_envs / config.batch_size
            while due >= 1.0:
                losses.append(learner.update(replay, run.budget.fraction(steps)))
                due -= 1.0
        if rows % _ROW == 0:
            run.tick(steps, **figures())
            losses.clear()
    run.finish(steps, **figures())
