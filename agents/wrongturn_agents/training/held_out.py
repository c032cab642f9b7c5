"""Held-out journeys, which no training and no suite uses: they decide which of a run's agents is kept."""

import copy
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from wrongturn_agents.training.drive import AnyModel, DrivenTrial, drive_trials
from wrongturn_networks import Town, draw_journey, load_town
from wrongturn_protocol import TRAINING_WEATHERS, Task, Traffic, Trial

_SEEDS = 2**40
"""First seed of these journeys, far above the suites' seeds."""
_TRAFFIC = Traffic(vehicles=20, pedestrians=50)


def held_out_journeys(count: int, towns: Sequence[Town] = ()) -> list[Trial]:
    """Draw journeys of CoRL 2017's task *navigation*, without traffic, with the training weathers in turn.

    They are in Town01 or, in turn, in Town01 and the given towns.
    """
    weathers, places = TRAINING_WEATHERS, (load_town("Town01"), *towns)
    return [
        draw_journey(places[i % len(places)], Task.NAVIGATION, _SEEDS + i, weather=weathers[i % len(weathers)])
        for i in range(count)
    ]


def with_traffic(journeys: Sequence[Trial]) -> list[Trial]:
    """Return the same journeys with as many other road users as in CoRL 2017's *dynamic navigation*."""

    def beside(trial: Trial) -> Trial:
        journey = trial.journey and trial.journey.model_copy(update={"task": Task.NAVIGATION_DYNAMIC})
        return trial.model_copy(update={"id": f"{trial.id}.traffic", "traffic": _TRAFFIC, "journey": journey})

    return [beside(journey) for journey in journeys]


def shortest(journeys: list[Trial], count: int) -> list[Trial]:
    """Return the journeys with the shortest time limits, in their order: an evaluation waits for its longest."""
    limits = sorted((journey.journey.time_limit if journey.journey else 0.0, i) for i, journey in enumerate(journeys))
    return [journeys[i] for i in sorted(i for _, i in limits[:count])]


def longest(journeys: Sequence[Trial]) -> float:
    """Return the longest time limit of some journeys, seconds."""
    return max((one.journey.time_limit for one in journeys if one.journey), default=1.0)


@dataclass(frozen=True)
class Evaluation:
    """Result of an agent on held-out journeys."""

    journeys: int
    """Number of journeys without other road users."""
    success: float
    """Share of journeys that reached their goal in time."""
    clean: float
    """Share of journeys that reached it without any infraction."""
    reward: float
    """Mean sum of the paper's reward."""
    traffic_success: float | None = None
    """Share of the journeys beside other road users that reached their goal in time; None if there were none."""

    @property
    def rank(self) -> tuple[float, float]:
        """Sort key; the best agent has the greatest: more successes, with and without traffic, then more reward."""
        if self.traffic_success is None:
            return self.success, self.reward
        return 0.5 * (self.success + self.traffic_success), self.reward

    @classmethod
    def each(
        cls,
        models: Sequence[AnyModel],
        trials: list[Trial],
        *,
        stop: Callable[[], bool] = lambda: False,
        least: int | None = None,
        **options: Any,
    ) -> "list[Evaluation] | None":
        """Evaluate several agents at once, on the journeys that all of them have ended.

        There is no result of fewer journeys, alone and beside traffic, than ``least``; by default of fewer than all.
        The rest is as in :func:`~wrongturn_agents.training.drive.drive_trials`.
        """
        driven = drive_trials(models, trials, stop=stop, **options)
        ended = [k for k in range(len(trials)) if not any(drives[k].stopped for drives in driven)]
        wanted, found = (Counter(_alone(trial) for trial in some) for some in (trials, [trials[k] for k in ended]))
        if any(found[kind] < min(count, least or count) for kind, count in wanted.items()):
            return None
        return [cls._of([drives[k] for k in ended]) for drives in driven]

    @classmethod
    def _of(cls, driven: list[DrivenTrial]) -> "Evaluation":
        alone = [one for one in driven if _alone(one.trial)]
        beside = [one for one in driven if not _alone(one.trial)]
        arrived = [one for one in alone if one.arrived]
        clean = [one for one in arrived if one.outcome and one.outcome.journey and one.outcome.journey.clean]
        count = max(1, len(alone))
        return cls(
            journeys=len(alone),
            success=len(arrived) / count,
            clean=len(clean) / count,
            reward=sum(one.reward for one in alone) / count,
            traffic_success=sum(one.arrived for one in beside) / len(beside) if beside else None,
        )


def _alone(trial: Trial) -> bool:
    return trial.traffic == Traffic()


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
        """Remember the agent as it is, before an update, unless another one drove better since the last evaluation."""
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
        """Keep an agent as the run's best."""
        model = _copy(candidate.model) if candidate.model is self._model else candidate.model
        self.best = Candidate(model, candidate.steps, candidate.reward, evaluation)

    def restore(self, told: dict[str, Any]) -> None:
        """Take the best agent of a run's checkpoint as the best."""
        kept = _copy(self._model)
        kept.load_state_dict(told["state_dict"])
        evaluation = Evaluation(**told["evaluation"]) if told["evaluation"] else None
        self.best = Candidate(kept, told["steps"], evaluation=evaluation)


def _copy(model: Any) -> Any:
    return copy.deepcopy(model).eval().requires_grad_(False)
