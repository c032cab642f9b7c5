"""What doubts a command, as a training method: it learns what pictures tell about the junction ahead."""

from pathlib import Path
from typing import Any, Final

import torch

from wrongturn_agents.models.doubt import Doubt
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS
from wrongturn_agents.training.method import Loaded, Method, TrainedAgent
from wrongturn_agents.training.methods.averaging import AveragedLearner
from wrongturn_agents.training.methods.doubting.config import DoubtingConfig, DoubtingSegmentationConfig
from wrongturn_agents.training.methods.doubting.frames import CHUNK, FrameSource, examine, temperatures
from wrongturn_agents.training.run import Run
from wrongturn_agents.training.run_directory import BEST
from wrongturn_agents.training.world import HELD_OUT, TRAINING_TOWN, mounts_of, towns_of
from wrongturn_networks import load_town
from wrongturn_protocol import Track

_ROW_EVERY: Final = 15.0
"""Seconds between two rows."""


class DoubtingMethod(Method):
    """A network that tells what the road offers. It drives as a shipped agent does, behind a gate."""

    unit = "pictures"
    columns = ("step", "minutes", "loss", "exits_loss", "distance_loss", "steps_per_second", "learning_rate")

    def __init__(self, settings: type[DoubtingConfig]) -> None:
        self.settings = settings
        agent = DOUBTING_AGENTS[settings.algorithm]
        self._key = "segmentation" if agent.track is Track.SEGMENTATION else "rgb"
        keys = ("speed", "command", self._key)
        self.agents = (TrainedAgent(agent.name, agent.track, keys, agent.description),)

    def build(self, settings: DoubtingConfig, algorithm: str) -> Doubt:  # noqa: ARG002
        """Return the untrained network."""
        return Doubt(self._key, augment=settings.augment, masked_classes=settings.masked_classes)

    def learn(self, run: Run) -> None:
        """Learn from fresh pictures until the budget is over, and tell how right the network is."""
        config: DoubtingConfig = run.settings
        towns = [load_town(TRAINING_TOWN), *towns_of(range(config.generated))]
        model: Any = self.build(config, self.name).to(run.device, memory_format=torch.channels_last)  # type: ignore[call-overload]
        learner = AveragedLearner(model, config)
        if run.state is not None:
            learner.restore(run)
        drawn = run.seed if learner.seen == 0 else run.stream(learner.seen)
        source = FrameSource(
            towns, drawn, first_share=config.first_share, device=run.device, threads=run.threads,
            cameras=mounts_of(CHUNK, level=True) if config.cameras else (), noise=config.noise,
        )  # fmt: skip
        source.draw(1)  # compiles what renders, before the clock of the learning begins
        run.open(learner.seen)
        shown = run.budget.used
        while not run.over(learner.seen):
            frames = source.draw(config.batch_size)
            with learner.precision():
                exits, marks = model.loss(
                    model.disturb(frames.observation), frames.distance, frames.exits, frames.shown
                )
            loss = exits + config.marks_weight * marks
            learner.learn(loss, len(frames.distance), run.budget.fraction(learner.seen))
            if run.budget.used - shown > _ROW_EVERY or run.over(learner.seen):
                shown = run.budget.used
                losses = {"loss": loss.item(), "exits_loss": exits.item(), "distance_loss": marks.item()}
                run.row(learner.seen, **losses, learning_rate=learner.rate)
            if run.save_due:
                run.save_state(learner=learner.state())
        average: Any = learner.average
        unseen = towns_of(HELD_OUT)
        mounts = mounts_of(CHUNK, 1)
        told = {
            "training town": examine(average, towns[:1], threads=run.threads),
            "towns never seen": examine(average, unseen, threads=run.threads),
            "the same, other cameras and noise": examine(
                average, unseen, threads=run.threads, cameras=mounts, noise=config.noise
            ),
            "temperatures": temperatures(average, unseen, source, threads=run.threads),
        }
        run.save(BEST, average, learner.seen, told)
        run.save_state(learner=learner.state())

    def export(self, loaded: Loaded, file: Path, precision: str, **options: Any) -> None:
        """Write what doubts, its gate and the agent that drives behind it as one ONNX file."""
        from wrongturn_agents.training.methods.doubting.exporting import write_doubting  # noqa: PLC0415 - needs onnx

        for unused in ("observations", "compared"):
            options.pop(unused, None)
        write_doubting(loaded, file, precision, **options)


RGB: Final = DoubtingMethod(DoubtingConfig)
SEGMENTATION: Final = DoubtingMethod(DoubtingSegmentationConfig)
