"""The agents among which a run's best is chosen: none is lost, whatever the next update does."""

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
    """Environment steps that it had learnt from."""
    reward: float = float("-inf")
    """Mean of the episodes before, in training."""
    evaluation: Evaluation | None = None


class Candidates:
    """The agent that drove best in training since the last evaluation, and the best that was evaluated.

    Args:
        model: the agent that learns.
    """

    def __init__(self, model: ActorCritic) -> None:
        self._model = model
        self._spare: list[ActorCritic] = []
        self.promising: Candidate | None = None
        """The best in training since the last evaluation, as it was before the update that followed."""
        self.best: Candidate | None = None

    def drove(self, reward: float, steps: int) -> None:
        """Remember the agent as it is, if no other drove better since the last evaluation.

        Called before an update: what comes out of it did not drive yet.
        """
        if self.promising is None:
            self.promising = Candidate(self._copy(), steps, reward)
        elif reward > self.promising.reward:
            _overwrite(self.promising.model, self._model)
            self.promising.steps, self.promising.reward = steps, reward

    def to_judge(self, steps: int, *, again: bool) -> list[Candidate]:
        """The agent as it is now, and those remembered: the promising one and, if asked for ``again``, the best."""
        found = [Candidate(self._model, steps)]
        for other in (self.promising, self.best if again else None):
            if other is not None and other.steps not in {one.steps for one in found}:
                found.append(other)
        return found

    def judged(self, candidate: Candidate, evaluation: Evaluation) -> None:
        """Keep the one that an evaluation chose as the best, and forget what was promising."""
        kept = Candidate(self._copy(candidate.model), candidate.steps, candidate.reward, evaluation)
        if self.best is not None:
            self._spare.append(self.best.model)
        self.best = kept

    def begin_anew(self) -> None:
        """Forget what was promising: it was judged."""
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
