"""The agents from which a run selects its best one. None is lost, whatever the next update does."""

import copy
from dataclasses import dataclass

import torch

from wrongturn_agents.models import ActorCritic
from wrongturn_agents.training.held_out import Evaluation


@dataclass
class Candidate:
    """An agent as it was at some time, on the device."""

    model: ActorCritic
    steps: int
    """Environment steps that it had learned from."""
    reward: float = float("-inf")
    """Mean reward of the training episodes before."""
    evaluation: Evaluation | None = None


class Candidates:
    """The best agent in training since the last evaluation, and the best evaluated agent.

    Args:
        model: the agent that learns.
    """

    def __init__(self, model: ActorCritic) -> None:
        self._model = model
        self._spare: list[ActorCritic] = []
        self.promising: Candidate | None = None
        """Best agent in training since the last evaluation, as it was before the update that followed."""
        self.best: Candidate | None = None

    def drove(self, reward: float, steps: int) -> None:
        """Remember the agent as it is, unless another one drove better since the last evaluation.

        Call it before an update: the agent after the update has not driven yet.
        """
        if self.promising is None:
            self.promising = Candidate(self._copy(), steps, reward)
        elif reward > self.promising.reward:
            _overwrite(self.promising.model, self._model)
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
        kept = Candidate(self._copy(candidate.model), candidate.steps, candidate.reward, evaluation)
        if self.best is not None:
            self._spare.append(self.best.model)
        self.best = kept

    def begin_anew(self) -> None:
        """Forget the promising agent after its evaluation."""
        if self.promising is not None:
            self._spare.append(self.promising.model)
        self.promising = None

    def _copy(self, model: ActorCritic | None = None) -> ActorCritic:
        model = model or self._model
        if not self._spare:
            made = copy.deepcopy(model).eval()
            return made.requires_grad_(False)
        made = self._spare.pop()
        _overwrite(made, model)
        return made


@torch.no_grad()
def _overwrite(target: ActorCritic, source: ActorCritic) -> None:
    for kept, live in zip(target.state_dict().values(), source.state_dict().values(), strict=True):
        kept.copy_(live)
