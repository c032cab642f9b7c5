"""Where an environment's trials come from: drawn in a town, out of a suite, or always the same."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from wrongturn_networks import NetworkError, draw_cruise, draw_journey, draw_trial, load_suite, load_town
from wrongturn_protocol import Fault, FaultKind, Task, Traffic, Trial, Weather
from wrongturn_sim.faults import FaultNotApplicableError, check_fault, fault_class

_SEEDS = 2**31


def a_flag(name: str, value: bool) -> bool:
    """The value, where it is True or False.

    Raises:
        ValueError: it is neither, as ``"no"`` is, which would count as true.
    """
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name}: is {value!r}; give True or False")
    return bool(value)


class TrialSource:
    """The trials of one environment, or of many; whoever draws brings the generator.

    Args:
        town: where trials are drawn.
        approach: the arm that all drawn trials drive in by; any that admits the fault where it is None.
        fault: of the drawn trials.
        suite: draw among this suite's trials and twins instead.
        trial: this trial each time; an id needs ``suite`` too.
        weather: of the drawn trials; of several, each trial draws its own.
        traffic: of the drawn trials, as ``{"vehicles": 20, "pedestrians": 10}``.
        task: draw journeys of this task, instead of single junctions.
        journeys: further arguments of :func:`wrongturn_networks.draw_cruise`, for the task ``cruise``.

    Raises:
        ValueError: names that do not exist, or do not go together.
    """

    def __init__(
        self,
        town: str | None = None,
        *,
        approach: str | None = None,
        fault: Fault | FaultKind | str = FaultKind.NONE,
        suite: str | None = None,
        trial: Trial | str | None = None,
        weather: Weather | str | Sequence[Weather | str] = Weather.CLEAR_NOON,
        traffic: Traffic | Mapping[str, int] = Traffic(),  # noqa: B008 - immutable
        task: Task | str | None = None,
        journeys: Mapping[str, Any] | None = None,
    ) -> None:
        if suite is not None and (town is not None or approach is not None):
            raise ValueError("suite: its trials name their towns; leave town and approach out")
        if isinstance(trial, str) and suite is None:
            raise ValueError(f"trial: the id {trial!r} needs the suite that it stands in; give suite, or a Trial")
        if suite is None and town is None and trial is None:
            raise ValueError("town: missing; name a town, or a suite, or give a trial")
        if task is not None and town is None:
            raise ValueError("task: journeys are drawn in a town; name one, and leave suite and trial out")
        if task is not None and task not in list(Task):
            raise ValueError(f"task: {task!r} is unknown; give one of {', '.join(Task)}")
        self._task = None if task is None else Task(task)
        if journeys is not None and self._task is not Task.CRUISE:
            raise ValueError("journeys: these are arguments of cruises; give task='cruise' with them")
        if journeys is not None and not isinstance(journeys, Mapping):
            raise ValueError(f"journeys: {journeys!r} holds no arguments by name; give a dict of them")
        self._journeys = dict(journeys or {})
        self._approach = approach
        self._suite = None if suite is None else load_suite(suite)
        self._fault = fault if isinstance(fault, Fault) else Fault(kind=FaultKind(fault))
        fault_class(self._fault.kind)
        names_of_weathers = weather if isinstance(weather, Iterable) and not isinstance(weather, str) else (weather,)
        for name in names_of_weathers:
            if name not in list(Weather):
                raise ValueError(f"weather: {name!r} is unknown; give one of {', '.join(Weather)}")
        self._weathers = tuple(Weather(name) for name in names_of_weathers)
        if not self._weathers:
            raise ValueError("weather: none is named; name one or more")
        self._traffic = Traffic.model_validate(traffic)
        self._town = None if town is None else load_town(town)
        self._trial = None if trial is None else self.find(trial)
        self._approaches: tuple[str, ...] = ()
        if self._task is not None:
            self._check_task()
        elif self._town is not None:
            names = sorted(self._town.approaches) if approach is None else [approach]
            self._approaches = tuple(name for name in names if self._admits(name, among=len(names)))
            if not self._approaches:
                raise FaultNotApplicableError(
                    f"fault: {self._fault.kind} suits no approach of {town}; take another fault or another town",
                )

    @property
    def towns(self) -> tuple[str, ...]:
        """The towns that drawn trials may be of, sorted."""
        if self._trial is not None:
            return (self._trial.town,)
        if self._suite is not None:
            return tuple(sorted({trial.town for trial in self._suite.trials}))
        assert self._town is not None
        return (self._town.name,)

    def find(self, trial: Trial | str) -> Trial:
        """The trial itself, or the suite's of that id.

        Raises:
            UnknownTrialError: the suite has no such trial.
            ValueError: there is no suite to look in.
        """
        if isinstance(trial, Trial):
            return trial
        if self._suite is None:
            raise ValueError(f"trial: the id {trial!r} needs an environment that was made with its suite")
        return self._suite.trial(trial)

    def draw(self, random: np.random.Generator) -> Trial:
        """The next trial."""
        if self._trial is not None:
            return self._trial
        if self._suite is not None:
            episodes = self._suite.episodes
            return episodes[int(random.integers(len(episodes)))]
        if self._task is not None:
            return self._journey(random)
        approach = self._approaches[int(random.integers(len(self._approaches)))]
        seed = int(random.integers(_SEEDS))
        # One weather takes no draw, so that naming none draws the trials that were always drawn.
        several = len(self._weathers) > 1
        return self._made(approach, seed, self._weathers[int(random.integers(len(self._weathers))) if several else 0])

    def _journey(self, random: np.random.Generator) -> Trial:
        assert self._town is not None
        weathers = self._weathers
        weather = weathers[int(random.integers(len(weathers)))] if len(weathers) > 1 else weathers[0]
        if self._task is Task.CRUISE:
            return draw_cruise(self._town, random, weather=weather, traffic=self._traffic, **self._journeys)
        assert self._task is not None
        seed = int(random.integers(_SEEDS))
        return draw_journey(
            self._town, self._task, seed, weather=weather, traffic=self._traffic, approach=self._approach
        )

    def _check_task(self) -> None:
        if self._fault.kind is not FaultKind.NONE:
            raise ValueError(f"fault: journeys are drawn without one, and {self._fault.kind} was named; leave it out")
        if self._task is Task.CRUISE and self._approach is not None:
            raise ValueError("approach: cruises begin anywhere in the town; leave it out")
        try:
            self._journey(np.random.default_rng(0))
        except TypeError as error:
            raise ValueError(f"journeys: {error}; see wrongturn_networks.draw_cruise") from None

    def _made(self, approach: str, seed: int, weather: Weather) -> Trial:
        assert self._town is not None
        return draw_trial(self._town, approach, self._fault, seed, weather=weather, traffic=self._traffic)

    def _admits(self, approach: str, *, among: int) -> bool:
        """Whether trials of the fault can be drawn at an approach; the reason why not, where it is the only one."""
        try:
            check_fault(self._made(approach, 0, self._weathers[0]))
        except NetworkError:
            if among == 1:
                raise
            return False
        return True
