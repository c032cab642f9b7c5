"""What an environment's trials are drawn from: the same options in process and over the wire."""

import inspect
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, Final, TypedDict, TypeVar, Unpack

import numpy as np
from pydantic import ValidationError

from wrongturn_protocol.episodes import Fault, Traffic, Trial
from wrongturn_protocol.suggestions import did_you_mean
from wrongturn_protocol.vocabulary import DIRECTIONS, Command, FaultKind, Task, Track, Weather

E = TypeVar("E", bound=Enum)
DEFAULT_TOWN: Final = "Town01"
"""The town to draw trials in where neither a town nor a suite nor a trial is named."""
_SEEDS: Final = 2**31
_NO_FAULT: Final = Fault(kind=FaultKind.NONE)
_NO_TRAFFIC: Final = Traffic()


class OptionError(ValueError):
    """An option of an environment or of its ``reset`` is unknown or invalid; the message names it and the remedy."""


class TrialKeywords(TypedDict, total=False):
    """Keyword arguments of the environments; :class:`TrialOptions` explains each."""

    approach: str | None
    fault: Fault | FaultKind | str
    task: Task | str | None
    journeys: Mapping[str, Any] | None
    route: Command | int | None
    weather: Weather | str | Sequence[Weather | str]
    traffic: Traffic | Mapping[str, int]
    suite: str | None
    trial: Trial | str | None


@dataclass(frozen=True)
class TrialOptions:
    """Which trials an environment draws: in a town, out of a suite, or the same one each time."""

    town: str | None = None
    """The town to draw trials in."""
    track: Track = Track.STATE
    """What the agent is shown."""
    approach: str | None = None
    """The arm by which all drawn trials drive in, such as ``J3-S``; by default any where the fault can be applied."""
    fault: Fault = _NO_FAULT
    """The fault of drawn trials."""
    task: Task | None = None
    """Draw journeys of this task, such as ``navigation`` or ``cruise``, instead of single junctions."""
    journeys: Mapping[str, Any] | None = None
    """Further arguments of ``wrongturn_networks.draw_cruise`` for the task ``cruise``; in process only."""
    route: Command | None = None
    """The direction of drawn trials' routes; by default the seed decides."""
    weathers: tuple[Weather, ...] = (Weather.CLEAR_NOON,)
    """The weathers of drawn trials; with several, each trial draws its own."""
    traffic: Traffic = _NO_TRAFFIC
    """The other road users of drawn trials, such as ``{"vehicles": 20, "pedestrians": 10}``."""
    suite: str | None = None
    """Draw among this suite's trials and their twins instead."""
    trial: Trial | str | None = None
    """Drive this trial each time: the id of one of the suite's, or in process a Trial."""

    @classmethod
    def of(
        cls, town: str | None = None, track: Track | str = Track.STATE, **given: Unpack[TrialKeywords]
    ) -> "TrialOptions":
        """Return the options that an environment was given; ``weather`` may be one or several.

        Raises:
            TypeError: There is no option of that name.
            OptionError: A value is wrong, or options do not go together.
        """
        if unknown := given.keys() - TrialKeywords.__annotations__.keys():
            raise TypeError(no_option(min(unknown), ("town", "track", *TrialKeywords.__annotations__)))
        _check_text("town", town)
        for name in ("approach", "suite"):
            _check_text(name, given.get(name))
        fault, task, route = given.get("fault", FaultKind.NONE), given.get("task"), given.get("route")
        options = cls(
            town=town,
            track=one_of("track", Track, track),
            approach=given.get("approach"),
            fault=fault if isinstance(fault, Fault) else Fault(kind=one_of("fault", FaultKind, fault)),
            task=None if task is None else one_of("task", Task, task),
            journeys=given.get("journeys"),
            route=None if route is None else _direction(route),
            weathers=_weathers(given.get("weather", Weather.CLEAR_NOON)),
            traffic=_traffic(given.get("traffic", _NO_TRAFFIC)),
            suite=given.get("suite"),
            trial=_trial(given.get("trial")),
        )
        options._check_suite()
        options._check_journeys()
        return options

    def draw_weather(self, random: np.random.Generator) -> Weather:
        """Return the weather of the next trial; a single weather takes no draw."""
        number = len(self.weathers)
        return self.weathers[int(random.integers(number)) if number > 1 else 0]

    def draw_seed(self, random: np.random.Generator) -> int:
        """Return the seed of the next trial."""
        return int(random.integers(_SEEDS))

    def _check_suite(self) -> None:
        if self.suite is not None and (self.town is not None or self.approach is not None):
            raise OptionError("suite: its trials name their towns; leave town and approach out")
        if self.suite is not None and self.task is not None:
            raise OptionError("suite: its trials have their own tasks; leave task out")
        if isinstance(self.trial, str) and self.suite is None:
            raise OptionError(
                f"trial: the id {self.trial!r} needs the suite that has it; give suite too, or in process a Trial"
            )

    def _check_journeys(self) -> None:
        if self.journeys is not None and self.task is not Task.CRUISE:
            raise OptionError("journeys: these are arguments of cruises; give task='cruise' with them")
        if self.journeys is not None and not isinstance(self.journeys, Mapping):
            raise OptionError(f"journeys: {self.journeys!r} holds no arguments by name; give a dict of them")
        if self.task is None:
            return
        if self.fault.kind is not FaultKind.NONE:
            raise OptionError(f"fault: journeys are drawn without one, and {self.fault.kind} was named; leave it out")
        if self.route is not None:
            raise OptionError("route: a journey's leads to its goal; leave it out, or task")
        if self.task is Task.CRUISE and self.approach is not None:
            raise OptionError("approach: cruises begin anywhere in the town; leave it out")


def check_keywords(made: Callable[..., object], given: Iterable[str]) -> None:
    """Raise TypeError, with all names, for an option neither of :class:`TrialOptions` nor of ``made``'s."""
    if unknown := set(given) - TrialKeywords.__annotations__.keys():
        own = [name for name, one in inspect.signature(made).parameters.items() if one.kind is not one.VAR_KEYWORD]
        raise TypeError(no_option(min(unknown), (*own, *TrialKeywords.__annotations__)))


def check_options(options: Mapping[str, Any] | None, known: Collection[str]) -> Mapping[str, Any]:
    """Return the ``options`` of a ``reset``, empty without any; raise OptionError for one that is not known."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise OptionError(f"options: is {options!r}; give a dict with {' or '.join(known)}")
    for name in options:
        if name not in known:
            raise OptionError(no_option(f"options.{name}", known))
    return options


def _direction(route: Command | int) -> Command:
    if isinstance(route, bool) or not isinstance(route, int | np.integer) or route not in DIRECTIONS:
        choices = ", ".join(f"{one.value} ({one.name})" for one in DIRECTIONS)
        raise OptionError(f"route: {route!r} is no direction; give one of {choices}")
    return Command(route)


def _traffic(traffic: object) -> Traffic:
    try:
        return Traffic.model_validate(traffic)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
    if not first["loc"]:
        raise OptionError(
            f"traffic: is {traffic!r}; give numbers by name, such as {{'vehicles': 20, 'pedestrians': 10}}"
        )
    name = str(first["loc"][0])
    if first["type"] == "extra_forbidden":
        raise OptionError(no_option(f"traffic.{name}", Traffic.model_fields))
    raise OptionError(f"traffic.{name}: is {first['input']!r}; give a whole number from 0 to 200")


def _trial(trial: object) -> Trial | str | None:
    if trial is None or isinstance(trial, Trial | str):
        return trial
    raise OptionError(f"trial: is {trial!r}; give the id of one of the suite's trials, or in process a Trial")


def _check_text(name: str, value: object) -> None:
    if value is not None and not isinstance(value, str):
        raise OptionError(f"{name}: is {value!r}; give its name as text")


def _weathers(weather: object) -> tuple[Weather, ...]:
    names = tuple(weather) if isinstance(weather, Iterable) and not isinstance(weather, str) else (weather,)
    if not names:
        raise OptionError("weather: none is named; name one or more")
    return tuple(one_of("weather", Weather, name) for name in names)


def whole_number(name: str, value: object) -> int:
    """Return an argument that counts something; raise OptionError if it is not a whole number, 1 or more."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise OptionError(f"{name}: is {value!r}; give a whole number, 1 or more")
    return int(value)


def one_of(name: str, kind: type[E], value: object) -> E:
    """Return an argument as a member of an enumeration; raise OptionError for an unknown value."""
    try:
        return kind(value)
    except ValueError:
        choices = [str(one.value) for one in kind]
        meant = did_you_mean(value, choices)
        raise OptionError(f"{name}: {value!r} is unknown; give one of {', '.join(choices)}{meant}") from None


def no_option(name: str, known: Iterable[str]) -> str:
    """Return what to say of an option that does not exist. The part of its name after the last dot is the wrong one."""
    options = list(known)
    meant = did_you_mean(name.rpartition(".")[2], options)
    return f"{name}: there is no such option; give {', '.join(options)}{meant}"
