"""What a run does besides learning: rows, evaluations, checkpoints and its end."""

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from wrongturn_agents.models import ActorCritic
from wrongturn_agents.training.candidates import Candidate, Candidates
from wrongturn_agents.training.checkpoint import save_checkpoint, write
from wrongturn_agents.training.driving_env import VERDICTS
from wrongturn_agents.training.held_out import Evaluation
from wrongturn_agents.training.ppo import WrongturnPPO
from wrongturn_agents.training.progress_file import ProgressFile

Row = dict[str, Any]
Evaluate = Callable[[Sequence[ActorCritic], bool], list[Evaluation] | None]
"""Drives held-out journeys with several agents. The flag asks for all journeys, at the end, instead of a few. Returns
None if time ran out.
"""
_FIGURES = ("success", "clean", "reward", "traffic_success")
"""Figures of an evaluation that a row holds."""
_EPISODES = 100
"""Number of episodes over which the training reward is averaged."""
_LATE = 0.93
"""Share of a run after which only the last evaluation is left."""


class RunCallback(BaseCallback):
    """Keeps a run's files and ends the run in time.

    Args:
        directory: directory of the run.
        seed: seed of the run.
        evaluate: see :data:`Evaluate`.
        candidates: agents from which the best is selected. A resumed run brings its best one.
        rows: ``progress.csv``.
        brief: number of journeys of the evaluations before the last.
        longer: time limit of the last evaluation's longest journey, divided by that of the brief ones.
        on_row: called with each row.
        evaluated_at: steps at the last evaluation.
    """

    model: WrongturnPPO

    def __init__(
        self,
        directory: Path,
        *,
        seed: int,
        evaluate: Evaluate,
        candidates: Candidates,
        rows: ProgressFile,
        brief: int,
        longer: float = 1.0,
        on_row: Callable[[Row], None] = lambda _: None,
        evaluated_at: int = 0,
    ) -> None:
        super().__init__()
        self._directory = directory
        self._seed = seed
        self._evaluate = evaluate
        self._candidates = candidates
        self._rows = rows
        self._brief = brief
        self._longer = longer
        self._on_row = on_row
        self.last: Evaluation | None = None
        self._evaluated_at = evaluated_at
        self._row_at = 0
        self._verdicts: Counter[str] = Counter()
        self._recent: deque[tuple[float, int]] = deque(maxlen=_EPISODES)
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

    def _on_rollout_end(self) -> None:
        """Consider the agent that drove as a candidate, before an update changes it."""
        if len(self._recent) == _EPISODES:
            learnt = self.model.num_timesteps - self.model.n_steps * self.model.n_envs
            self._candidates.drove(self._reward(), max(0, learnt))

    def _reward(self) -> float:
        return float(np.mean([reward for reward, _ in self._recent]))

    def _on_rollout_start(self) -> None:
        """Report, evaluate and save what was learned from the last rollout."""
        model = self.model
        if model.num_timesteps == self._row_at:
            return
        due = model.num_timesteps - self._evaluated_at >= model.config.evaluate_every
        late = model.budget.fraction(model.num_timesteps) >= _LATE
        self._report(self._judged() if due and not late else None)
        if model.budget.used - self._saved_at > 60.0 * model.config.save_every:
            self._save("last.pt", Candidate(model.policy.model, model.num_timesteps, evaluation=self.last))
            self._save_state()

    def _on_training_end(self) -> None:
        self._report(self._judged(last=True))

    def _judged(self, *, last: bool = False) -> Evaluation | None:
        """Evaluate the agent and its candidates, and save them. Return the current agent's evaluation."""
        model, candidates = self.model, self._candidates
        begin = time.monotonic()
        known = candidates.best.evaluation if candidates.best else None
        again = last or (known is not None and known.journeys != self._brief)
        chosen = candidates.to_judge(model.num_timesteps, again=again)
        with model.stopwatch.part("evaluate"):
            model.policy.set_training_mode(False)
            found = self._evaluate([one.model for one in chosen], last)
        self._evaluated_at = model.num_timesteps
        if found is not None:
            best = max(range(len(chosen)), key=lambda i: found[i].rank)
            if again or known is None or found[best].rank > known.rank:
                candidates.judged(chosen[best], found[best])
                self._save("best.pt", candidates.best)
            candidates.begin_anew()
            self.last = found[0]
        elif candidates.best is None:
            self._save("best.pt", candidates.promising or chosen[0])
        now = found[0] if found else None
        self._save("last.pt", Candidate(model.policy.model, model.num_timesteps, evaluation=now))
        self._save_state()
        if model.budget.seconds is not None and not last:
            # Keep time for the last evaluation, which comes after learning.
            needed = 1.3 * self._longer * (time.monotonic() - begin)
            model.budget.reserve = min(needed, 0.3 * model.budget.seconds)
        return now

    def _report(self, evaluation: Evaluation | None) -> None:
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
            "reward_mean": self._reward() if rewards else None,
            "episode_length": float(np.mean(lengths)) if lengths else None,
            "reward_per_decision": sum(rewards) / sum(lengths) if lengths else None,
            **{verdict: self._verdicts[verdict] / ended for verdict in VERDICTS},
            "steps_per_second": steps / max(whole - seconds.get("evaluate", 0.0), 1e-9),
            **{f"seconds_{part}": value for part, value in seconds.items()},
            **model.figures,
        }
        if evaluation is not None:
            row |= {f"{name}_heldout": getattr(evaluation, name) for name in _FIGURES}
        self._row_at = model.num_timesteps
        self._verdicts.clear()
        self._rows.add(row)
        for name, value in row.items():
            if value is not None and name not in model.figures:
                self.logger.record(f"run/{name}", value)
        self.logger.dump(model.num_timesteps)
        self._on_row(row)

    def _save(self, name: str, candidate: Candidate | None) -> None:
        assert candidate is not None
        save_checkpoint(
            self._directory / name,
            candidate.model,
            self.model.config,
            seed=self._seed,
            steps=candidate.steps,
            evaluation=asdict(candidate.evaluation) if candidate.evaluation else {},
        )

    def _save_state(self) -> None:
        """Save what a run continues from: everything except the drives in progress."""
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
                "caution": model.caution,
                "evaluated_at": self._evaluated_at,
            },
        )
