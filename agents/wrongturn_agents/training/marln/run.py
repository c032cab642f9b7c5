"""A run of MaRLn: its encoder's pretraining, its drives and updates, its evaluations and its files."""

import copy
import json
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

from wrongturn_agents.models.marln import Marln
from wrongturn_agents.training.budget import Budget
from wrongturn_agents.training.checkpoint import load_checkpoint, read, save_checkpoint, write
from wrongturn_agents.training.driving_env import VERDICTS
from wrongturn_agents.training.environments import driving_envs
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.held_out import Evaluation, held_out_journeys, longest, shortest, with_traffic
from wrongturn_agents.training.marln.cars import Cars
from wrongturn_agents.training.marln.config import MarlnConfig
from wrongturn_agents.training.marln.learning import Learned, Learner
from wrongturn_agents.training.marln.network import build_marln
from wrongturn_agents.training.marln.pretraining import pretrain
from wrongturn_agents.training.marln.replay import Replay
from wrongturn_agents.training.progress_file import ProgressFile
from wrongturn_agents.training.run_directory import ENCODER, STATE
from wrongturn_agents.training.stopwatch import Stopwatch

Row = dict[str, Any]
_ROW: Final = 64
"""Decisions of each car between two rows of ``progress.csv``."""
_EPISODES: Final = 100
"""Drives over which the reward is averaged."""
_LATE: Final = 0.93
"""Share of a run after which only the last evaluation is left."""
_ENCODER: Final = ("network.", "affordances.")
STATE_KEYS: Final = {
    "steps",
    "updates",
    "seconds",
    "begun",
    "values",
    "target",
    "optimizer",
    "generator",
    "evaluated_at",
}
"""What a run's state holds."""


def load_encoder(path: Path) -> dict[str, torch.Tensor]:
    """Return the weights in a run's ``encoder.pt``.

    Raises:
        TrainingError: the file is missing, or is none.
    """
    found = read(path, "option encoder:", "a run's encoder.pt")
    weights = found.get("state_dict") if isinstance(found, dict) else None
    if not isinstance(weights, dict) or not all(name.startswith(_ENCODER) for name in weights):
        raise TrainingError(f"option encoder: {path} is no encoder of marln; name a run's encoder.pt")
    return weights


def run(
    config: MarlnConfig,
    folder: Path,
    *,
    seed: int,
    budget: Budget,
    device: torch.device,
    threads: int,
    stream: int,
    state: dict[str, Any] | None,
    encoder: dict[str, torch.Tensor] | None,
    on_row: Callable[[Row], None],
    on_pretraining: Callable[[int, float], None],
) -> Path:
    """Train an agent in a directory that is held, and return the best checkpoint's path.

    Args:
        config: settings.
        folder: the run's directory.
        seed: the run's seed.
        budget: steps and minutes.
        device: device of everything.
        threads: threads that share the simulation.
        stream: first seed of the drives.
        state: what a resumed run continues from.
        encoder: weights of another run's encoder; None to pretrain one.
        on_row: called with each row of ``progress.csv``.
        on_pretraining: called with the number of stacks and the loss.
    """
    model = build_marln(config, seed).to(device)
    if state is not None:
        encoder = load_encoder(folder / ENCODER)
    if encoder is not None:
        _take(encoder, model, config)
    elif config.pretrained:
        torch.manual_seed(seed)
        found = pretrain(
            model,
            config,
            device=device,
            seed=stream,
            budget=budget,
            threads=threads,
            on_progress=on_pretraining,
        )
        (folder / "pretraining.json").write_text(json.dumps(asdict(found), indent=1) + "\n", "utf-8")
    model.eval()
    for part in (model.network, model.affordances):
        part.requires_grad_(False)
    if state is None:
        content = {name: one.cpu() for name, one in model.state_dict().items() if name.startswith(_ENCODER)}
        write(folder / ENCODER, {"state_dict": content, "seconds": budget.used})
    training = _Training(config, folder, seed, model, budget, device, threads, stream, state, on_row)
    try:
        training.learn()
    finally:
        training.close()
    return folder / "best.pt"


def _take(weights: dict[str, torch.Tensor], model: Marln, config: MarlnConfig) -> None:
    try:
        missing, unexpected = model.load_state_dict(weights, strict=False)
    except (RuntimeError, TypeError, AttributeError) as error:
        raise TrainingError(
            f"option encoder: {config.encoder} does not fit this version's network; name another run's encoder.pt"
        ) from error
    lacking = [name for name in missing if name.startswith(_ENCODER)]
    if lacking or unexpected:
        raise TrainingError(f"option encoder: {config.encoder}: {(lacking + unexpected)[0]} does not fit; name another")


@dataclass
class _Best:
    model: Marln
    steps: int
    evaluation: Evaluation


class _Training:
    """The drives and updates of a run, with its rows, evaluations and checkpoints."""

    def __init__(
        self,
        config: MarlnConfig,
        folder: Path,
        seed: int,
        model: Marln,
        budget: Budget,
        device: torch.device,
        threads: int,
        stream: int,
        state: dict[str, Any] | None,
        on_row: Callable[[Row], None],
    ) -> None:
        self._config, self._folder, self._seed, self._model = config, folder, seed, model
        self._budget, self._device, self._threads, self._on_row = budget, device, threads, on_row
        self._generator = torch.Generator(device).manual_seed(stream)
        self._learner = Learner(model.values, config, self._generator)
        self._stopwatch = Stopwatch(device)
        self._steps, self._evaluated_at, self._due = 0, 0, 0.0
        self._best: _Best | None = None
        self._journeys = held_out_journeys(config.journeys)
        self._brief = shortest(self._journeys, config.brief_journeys)
        if state is not None:
            self._restore(state)
        budget.begun = state["begun"] if state else budget.used
        self._rows = ProgressFile(folder / "progress.csv", resumed_at=self._steps if state else None)
        envs = driving_envs(config, device, self._stopwatch, threads=threads)
        envs.seed(stream)
        self._cars = Cars(envs, model, config, self._stopwatch, self._generator)
        self._replay = Replay(
            config.replay_size,
            config.num_envs,
            model.width,
            n_step=config.n_step,
            gamma=config.gamma,
            exponent=config.priority_exponent,
            device=device,
        )
        self._verdicts: Counter[str] = Counter()
        self._recent: deque[tuple[float, int]] = deque(maxlen=_EPISODES)
        self._learned: list[Learned] = []
        self._row_at, self._begun_at, self._saved_at = self._steps, self._steps, budget.used

    def learn(self) -> None:
        """Drive and learn until the budget is over, then evaluate for the last time."""
        config, count = self._config, 0
        self._stopwatch.lap()
        while not self._budget.over(self._steps):
            decisions, ended = self._cars.drive()
            with self._stopwatch.part("buffer"):
                self._replay.add(decisions)
            self._steps += config.num_envs
            count += 1
            for info in ended:
                self._verdicts[info["verdict"]] += 1
                self._recent.append((info["episode"]["r"], info["episode"]["l"]))
            if self._steps - self._begun_at >= config.learn_after:
                self._update()
            if count % _ROW == 0:
                self._finish_row()
        self._report(self._judge(last=True))

    def close(self) -> None:
        """Stop the simulation's threads."""
        self._cars.envs.close()

    def _update(self) -> None:
        config = self._config
        self._due += config.replay_ratio * config.num_envs / config.batch_size
        fraction = self._budget.fraction(self._steps)
        with self._stopwatch.part("learn"):
            while self._due >= 1.0:
                self._learned.append(self._learner.update(self._replay, fraction))
                self._due -= 1.0

    def _finish_row(self) -> None:
        due = self._steps - self._evaluated_at >= self._config.evaluate_every
        late = self._budget.fraction(self._steps) >= _LATE
        self._report(self._judge() if due and not late else None)
        if self._budget.used - self._saved_at > 60.0 * self._config.save_every:
            self._save(None)

    def _judge(self, *, last: bool = False) -> Evaluation | None:
        """Evaluate the agent, at the end beside the best one so far; keep the better one as ``best.pt``."""
        begin, best = time.monotonic(), self._best
        models = [self._model] if best is None or not last else [self._model, best.model]
        journeys = self._journeys if last else self._brief
        with self._stopwatch.part("evaluate"):
            found = Evaluation.each(
                models,
                [*journeys, *with_traffic(journeys)] if self._config.traffic else journeys,
                track=self._config.track,
                device=self._device,
                threads=self._threads,
                patience=self._config.patience,
                strict=self._config.strict_evaluation,
                stop=self._budget.out_of_time,
                least=self._config.brief_journeys,
            )
        self._evaluated_at = self._steps
        now = found[0] if found else None
        if found is not None:
            if last and best is not None:
                best.evaluation = found[1]
            if best is None or found[0].rank > best.evaluation.rank:
                self._best = _Best(copy.deepcopy(self._model), self._steps, found[0])
            self._save_best()
        elif best is None:
            self._checkpoint("best.pt", self._model, self._steps, None)
        self._save(now)
        if self._budget.seconds is not None and not last:
            # Keep time for the last evaluation, which comes after learning.
            longer = longest(self._journeys) / longest(self._brief)
            self._budget.reserve = min(1.3 * longer * (time.monotonic() - begin), 0.3 * self._budget.seconds)
        return now

    def _report(self, evaluation: Evaluation | None) -> None:
        seconds = self._stopwatch.lap()
        whole, steps = seconds.pop("whole"), self._steps - self._row_at
        ended = max(1, self._verdicts.total())
        rewards, lengths = [r for r, _ in self._recent], [length for _, length in self._recent]
        row: Row = {
            "step": self._steps,
            "done": self._budget.fraction(self._steps),
            "minutes": self._budget.used / 60.0,
            "reward_mean": float(np.mean(rewards)) if rewards else None,
            "episode_length": float(np.mean(lengths)) if lengths else None,
            "reward_per_decision": sum(rewards) / sum(lengths) if lengths else None,
            **{verdict: self._verdicts[verdict] / ended for verdict in VERDICTS},
            "steps_per_second": steps / max(whole - seconds.get("evaluate", 0.0), 1e-9),
            **{f"seconds_{part}": value for part, value in seconds.items()},
            "learning_rate": self._learner.optimizer.param_groups[0]["lr"],
            "minibatches": len(self._learned),
        }
        if self._learned:
            row["value_loss"] = float(torch.stack([one.loss for one in self._learned]).mean())
        if evaluation is not None:
            row |= {
                f"{name}_heldout": getattr(evaluation, name)
                for name in ("success", "clean", "reward", "traffic_success")
            }
        self._row_at = self._steps
        self._verdicts.clear()
        self._learned.clear()
        self._rows.add(row)
        self._on_row(row)

    def _save_best(self) -> None:
        if self._best is not None:
            self._checkpoint("best.pt", self._best.model, self._best.steps, self._best.evaluation)

    def _checkpoint(self, name: str, model: Marln, steps: int, evaluation: Evaluation | None) -> None:
        said = asdict(evaluation) if evaluation else {}
        save_checkpoint(self._folder / name, model, self._config, seed=self._seed, steps=steps, evaluation=said)

    def _save(self, evaluation: Evaluation | None) -> None:
        """Save ``last.pt`` and what a run continues from: everything except replay memory and drives in progress."""
        self._saved_at = self._budget.used
        self._checkpoint("last.pt", self._model, self._steps, evaluation)
        learner = self._learner
        write(
            self._folder / STATE,
            {
                "steps": self._steps,
                "updates": learner.updates,
                "seconds": self._budget.used,
                "begun": self._budget.begun,
                "values": learner.values.state_dict(),
                "target": learner.target.state_dict(),
                "optimizer": learner.optimizer.state_dict(),
                "generator": self._generator.get_state(),
                "evaluated_at": self._evaluated_at,
            },
        )

    def _restore(self, state: dict[str, Any]) -> None:
        learner = self._learner
        try:
            learner.values.load_state_dict(state["values"])
            learner.target.load_state_dict(state["target"])
            learner.optimizer.load_state_dict(state["optimizer"])
        except (RuntimeError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise TrainingError(
                f"resume: {STATE} is of other networks than this version's; begin anew in another directory"
            ) from error
        learner.updates = state["updates"]
        self._generator.set_state(state["generator"])
        self._steps, self._evaluated_at = state["steps"], state["evaluated_at"]
        path = self._folder / "best.pt"
        told = load_checkpoint(path) if path.is_file() else None
        if told is not None and told["evaluation"]:
            model = copy.deepcopy(self._model)
            model.load_state_dict(told["state_dict"])
            self._best = _Best(model, told["steps"], Evaluation(**told["evaluation"]))
