"""What happens beside learning: rows, evaluations, checkpoints, the end."""

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from wrongturn_agents.training.checkpoint import save_checkpoint, write
from wrongturn_agents.training.driving_env import VERDICTS
from wrongturn_agents.training.held_out import Evaluation
from wrongturn_agents.training.ppo import WrongturnPPO
from wrongturn_agents.training.progress_file import ProgressFile

Row = dict[str, Any]


class RunCallback(BaseCallback):
    """Keeps a run's files, and ends it in time.

    Args:
        directory: of the run.
        seed: of the run.
        evaluate: drives the held-out journeys.
        rows: ``progress.csv``.
        on_row: told of each row.
        best: the best evaluation of a run that is resumed.
        evaluated_at: the steps at which it was evaluated last.
    """

    model: WrongturnPPO

    def __init__(
        self,
        directory: Path,
        *,
        seed: int,
        evaluate: Callable[[], Evaluation],
        rows: ProgressFile,
        on_row: Callable[[Row], None] = lambda _: None,
        best: Evaluation | None = None,
        evaluated_at: int = 0,
    ) -> None:
        super().__init__()
        self._directory = directory
        self._seed = seed
        self._evaluate = evaluate
        self._rows = rows
        self._on_row = on_row
        self.best = best
        self.last: Evaluation | None = None
        self._evaluated_at = evaluated_at
        self._row_at = 0
        self._verdicts: Counter[str] = Counter()
        self._recent: deque[tuple[float, int]] = deque(maxlen=100)
        self._saved_at = 0.0

    def _on_training_start(self) -> None:
        self._saved_at = self.model.budget.used
        self._row_at = self.model.num_timesteps
        self.model.stopwatch.lap()

    def _on_step(self) -> bool:
        for i in np.flatnonzero(self.locals["dones"]).tolist():
            info = self.locals["infos"][i]
            self._verdicts[info["verdict"]] += 1
            self._recent.append((info["episode"]["r"], info["episode"]["l"]))
        return not self.model.budget.over()

    def _on_rollout_start(self) -> None:
        """Between two rollouts: what was learnt from the last one is told, judged and written."""
        model = self.model
        if model.num_timesteps == self._row_at:
            return
        due = model.num_timesteps - self._evaluated_at >= model.config.evaluate_every
        self._told(self._judged() if due and not model.budget.over(model.num_timesteps) else None)
        if model.budget.used - self._saved_at > 60.0 * model.config.save_every:
            self._save("last.pt", self.last)
            self._save_state()

    def _on_training_end(self) -> None:
        self._told(self._judged())

    def _judged(self) -> Evaluation:
        """Evaluate, and keep what is to be kept."""
        model = self.model
        begin = time.monotonic()
        with model.stopwatch.part("evaluate"):
            model.policy.set_training_mode(False)
            found = self._evaluate()
        self._evaluated_at = model.num_timesteps
        self.last = found
        if self.best is None or found.rank > self.best.rank:
            self.best = found
            self._save("best.pt", found)
        self._save("last.pt", found)
        self._save_state()
        if model.budget.seconds is not None:
            # The last evaluation comes after learning: what it will take is kept back.
            model.budget.reserve = max(model.budget.reserve, 1.05 * (time.monotonic() - begin))
        return found

    def _told(self, evaluation: Evaluation | None) -> None:
        model = self.model
        seconds = model.stopwatch.lap()
        whole, steps = seconds.pop("whole"), model.num_timesteps - self._row_at
        ended = max(1, self._verdicts.total())
        rewards = [reward for reward, _ in self._recent]
        lengths = [length for _, length in self._recent]
        row: Row = {
            "step": model.num_timesteps,
            "done": model.budget.fraction(model.num_timesteps),
            "minutes": model.budget.used / 60.0,
            "reward_mean": float(np.mean(rewards)) if rewards else None,
            "episode_length": float(np.mean(lengths)) if lengths else None,
            "reward_per_decision": sum(rewards) / sum(lengths) if lengths else None,
            **{verdict: self._verdicts[verdict] / ended for verdict in VERDICTS},
            "steps_per_second": steps / max(whole - seconds.get("evaluate", 0.0), 1e-9),
            **{f"seconds_{part}": value for part, value in seconds.items()},
            **model.told,
        }
        if evaluation is not None:
            row |= {f"{name}_heldout": getattr(evaluation, name) for name in ("success", "clean", "reward")}
        self._row_at = model.num_timesteps
        self._verdicts.clear()
        self._rows.add(row)
        for name, value in row.items():
            if value is not None and name not in model.told:
                self.logger.record(f"run/{name}", value)
        self.logger.dump(model.num_timesteps)
        self._on_row(row)

    def _save(self, name: str, evaluation: Evaluation | None) -> None:
        model = self.model
        save_checkpoint(
            self._directory / name,
            model.policy.model,
            model.config,
            seed=self._seed,
            steps=model.num_timesteps,
            evaluation=asdict(evaluation) if evaluation else {},
        )

    def _save_state(self) -> None:
        """What a run goes on from: all but the episodes that are being driven."""
        model = self.model
        self._saved_at = model.budget.used
        write(
            self._directory / "state.pt",
            {
                "steps": model.num_timesteps,
                "updates": model._n_updates,
                "seconds": model.budget.used,
                "begun": model.budget.begun,
                "policy": model.policy.state_dict(),
                "optimizer": model.policy.optimizer.state_dict(),
                "torch": torch.get_rng_state(),
                "cuda": torch.cuda.get_rng_state_all() if model.device.type == "cuda" else [],
                "best": asdict(self.best) if self.best else None,
                "evaluated_at": self._evaluated_at,
            },
        )
