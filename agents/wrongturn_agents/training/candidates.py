"""The agents from which a run selects its best one. None is lost, whatever the next update does."""

import copy
from dataclasses import dataclass
from typing import Any

from wrongturn_agents.training.held_out import Evaluation


@dataclass
class Candidate:
    """An agent as it was at some time, on the device."""

    model: Any
    steps: int
    """Environment steps that it had learned from."""
    reward: float = float("-inf")
    """Mean reward of the training episodes before."""
    evaluation: Evaluation | None = None


class Candidates:
    """The best agent in training since the last evaluation, and the best evaluated agent."""

    def __init__(self, model: Any) -> None:
        self._model = model
        self.promising: Candidate | None = None
        """Best agent in training since the last evaluation, as it was before the update that followed."""
        self.best: Candidate | None = None

    def drove(self, reward: float, steps: int) -> None:
        """Remember the agent as it is, unless another one drove better since the last evaluation.

        Call it before an update: the agent after the update has not driven yet.
        """
        if self.promising is None:
            self.promising = Candidate(_copy(self._model), steps, reward)
        elif reward > self.promising.reward:
            self.promising.model.load_state_dict(self._model.state_dict())  # in the memory that it has
            self.promising.steps, self.promising.reward = steps, reward

    def to_judge(self, steps: int, *, again: bool) -> list[Candidate]:
        """Return the current agent, the promising one and, if ``again``, also the best one."""
        found = [Candidate(self._model, steps)]
        for other in (self.promising, self.best if again else None):
            if other is not None and other.steps not in {one.steps for one in found}:
                found.append(other)
        return found

    def judged(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Keep the best agent of an evaluation as the run's best."""
        model = _copy(candidate.model) if candidate.model is self._model else candidate.model
        self.best = Candidate(model, candidate.steps, candidate.reward, evaluation)

    def begin_anew(self) -> None:
        """Forget the promising agent after its evaluation."""
        self.promising = None


def _copy(model: Any) -> Any:
    return copy.deepcopy(model).eval().requires_grad_(False)
