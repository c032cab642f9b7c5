"""What an environment over the wire practises: the trials that it draws."""

from collections.abc import Mapping
from typing import Any, Final, TypedDict

import numpy as np

from wrongturn_client.client import Client
from wrongturn_protocol import Command, Fault, FaultKind, PracticeRequest, Task, Track, Traffic, Weather

_SEEDS: Final = 2**31
_DEFAULT_TOWN: Final = "Town01"


class Options(TypedDict, total=False):
    """What may be said of the trials; see :class:`PracticeSource`."""

    track: Track | str
    town: str | None
    approach: str | None
    fault: Fault | FaultKind | str
    task: Task | str | None
    route: Command | int | None
    weather: Weather | str
    traffic: Traffic | Mapping[str, int]
    suite: str | None
    trial: str | None


class PracticeSource:
    """Draws trials: from a town, or from a suite.

    Args:
        track: what is shown.
        town: where trials are drawn, ``Town01`` by default.
        approach: the arm that all drawn trials drive in by, such as ``J3-S``; any that admits the fault by default.
        fault: of the drawn trials.
        task: draw journeys of this task, such as ``navigation``, which go on over any number of junctions.
        route: the direction of the drawn trials' route; by the seed by default.
        weather: of the drawn trials.
        traffic: of the drawn trials, as ``{"vehicles": 20, "pedestrians": 10}``.
        suite: draw among this suite's open trials and their twins instead.
        trial: this trial of the suite each time.

    Raises:
        ValueError: names that do not exist, or do not go together.
    """

    def __init__(
        self,
        *,
        track: Track | str = Track.STATE,
        town: str | None = None,
        approach: str | None = None,
        fault: Fault | FaultKind | str = FaultKind.NONE,
        task: Task | str | None = None,
        route: Command | int | None = None,
        weather: Weather | str = Weather.CLEAR_NOON,
        traffic: Traffic | Mapping[str, int] = Traffic(),  # noqa: B008 - immutable
        suite: str | None = None,
        trial: str | None = None,
    ) -> None:
        self.track = Track(track)
        if suite is not None and (town is not None or approach is not None):
            raise ValueError("suite: its trials name their towns; leave town and approach out")
        if suite is not None and task is not None:
            raise ValueError("suite: its trials have their own tasks; leave task out")
        if trial is not None and suite is None:
            raise ValueError(f"trial: {trial!r} needs the suite that it stands in; give suite too")
        self._town = town or _DEFAULT_TOWN
        self._fault = fault if isinstance(fault, Fault) else Fault(kind=FaultKind(fault))
        self._task = None if task is None else Task(task)
        self._route = None if route is None else Command(route)
        self._weather = Weather(weather)
        self._traffic = Traffic.model_validate(traffic)
        self._suite = suite
        self._approaches: tuple[str, ...] = () if approach is None else (approach,)
        self._trials: tuple[str, ...] = () if trial is None else (trial,)

    def draw(self, client: Client, random: np.random.Generator, trial: str | None = None) -> PracticeRequest:
        """The next trial; the same generator gives the same ones.

        Args:
            client: is asked once for the approaches or trials that there are.
            random: the environment's.
            trial: this one of the suite instead.

        Raises:
            ValueError: there is no such approach, or no suite to take a trial from.
            WrongturnError: the service cannot be reached, or refuses.
        """
        if self._suite is not None:
            if trial is None and not self._trials:
                trials = client.trials(self._suite)
                self._trials = tuple(name for one in trials for name in (one.id, one.twin) if name)
                if not self._trials:
                    raise ValueError(f"suite: {self._suite} shows no trials for practice; take another")
            chosen = trial or self._trials[int(random.integers(len(self._trials)))]
            return PracticeRequest(suite=self._suite, trial=chosen, track=self.track)
        if trial is not None:
            raise ValueError(f"options: the trial {trial!r} needs an environment that was made with its suite")
        if not self._approaches and self._task is None:
            approaches = client.town(self._town).approaches
            self._approaches = tuple(sorted(one.id for one in approaches if self._admits(one)))
            if not self._approaches:
                offered = ", ".join(sorted({kind for one in approaches for kind in one.faults}))
                raise ValueError(
                    f"fault: {self._fault.kind} can be applied at no such approach of {self._town}, "
                    f"whose approaches offer {offered}; take another",
                )
        # A journey may begin anywhere.
        number = len(self._approaches)
        approach = self._approaches[int(random.integers(number))] if number else None
        return PracticeRequest.model_validate(
            {
                "town": self._town,
                "approach": approach,
                "task": self._task,
                "route": self._route,
                "fault": self._fault,
                "weather": self._weather,
                "traffic": self._traffic,
                "seed": int(random.integers(_SEEDS)),
                "track": self.track,
            },
        )

    def _admits(self, approach: Any) -> bool:
        if self._route is not None and self._route not in approach.exits:
            return False
        return self._fault.kind in approach.faults
