"""The trials that an environment in process draws, and checks of its other arguments."""

import inspect
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np
from pydantic import ValidationError

from wrongturn_networks import (
    CruiseError,
    NetworkError,
    Town,
    draw_cruise,
    draw_journey,
    draw_trial,
    load_suite,
    load_town,
)
from wrongturn_networks.faults import FaultNotApplicableError, check_fault, fault_class
from wrongturn_networks.loading import town_named
from wrongturn_networks.suites import suite_named
from wrongturn_protocol import OptionError, Task, Trial, TrialOptions, Weather
from wrongturn_protocol.observations import IMAGE_SHAPE
from wrongturn_protocol.trial_options import DEFAULT_TOWN, no_option

if TYPE_CHECKING:
    from wrongturn_sim.camera import Camera

_NOT_OF_JOURNEYS: Final = frozenset({"town", "random", "weather", "traffic"})
"""Arguments of ``draw_cruise`` that are not in ``journeys``: the environment has options for them."""


def a_flag(name: str, value: bool) -> bool:
    """Return the value of a flag; raise OptionError for others than booleans, such as ``"no"``, which would be true."""
    if not isinstance(value, bool | np.bool_):
        raise OptionError(f"{name}: is {value!r}; give True or False")
    return bool(value)


def picture_size(camera: "Camera | Sequence[Camera] | None", count: int = 1) -> tuple[int, int]:
    """Return rows and columns of the pictures of a camera, or of ``count`` alike; by default the benchmark's.

    Raises OptionError.
    """
    if camera is None:
        return IMAGE_SHAPE
    # Slow, and most environments need none of their own.
    from wrongturn_sim.camera import Camera, CameraError  # noqa: PLC0415
    from wrongturn_sim.camera.pinhole import one_size  # noqa: PLC0415

    cameras = camera if isinstance(camera, Sequence) else [camera]
    if not all(isinstance(one, Camera) for one in cameras):
        raise OptionError(f"camera: is {camera!r}; give a wrongturn_sim.camera.Camera")
    try:
        one = one_size(cameras, count if cameras is camera else 1)
    except CameraError as error:
        raise OptionError(str(error)) from error
    return one.height, one.width


class TrialSource:
    """Draws the trials of one environment, or of many; each environment brings its own generator."""

    def __init__(self, options: TrialOptions, town: Town | None = None) -> None:
        """Load the town or suite, and find the approaches where the fault can be applied.

        Trials are drawn in ``Town01`` if the options name neither a town nor a suite nor a trial; ``town`` is the one
        that they name, if it is not installed. Raises OptionError if a town, suite or trial does not exist, or there is
        none to draw from.
        """
        if options.suite is None and options.town is None and options.trial is None:
            options = replace(options, town=DEFAULT_TOWN)
        if options.task is not None and options.town is None:
            raise OptionError("task: journeys are drawn in a town; name one, and leave suite and trial out")
        fault_class(options.fault.kind)
        if options.suite is not None:
            options = replace(options, suite=suite_named(options.suite))
        if options.town is not None and town is None:
            options = replace(options, town=town_named(options.town))
        self._options = options
        self._suite = None if options.suite is None else load_suite(options.suite)
        self._town = town or (None if options.town is None else load_town(options.town))
        self._trial = None if options.trial is None else self.find(options.trial)
        self._approaches: tuple[str, ...] = ()
        if options.task is not None:
            self._check_journeys()
        elif self._town is not None:
            names = sorted(self._town.approaches) if options.approach is None else [options.approach]
            self._approaches = tuple(name for name in names if self._suits(name, among=len(names)))
            if not self._approaches:
                raise FaultNotApplicableError(
                    f"fault: {options.fault.kind} suits no approach of {options.town}; "
                    "take another fault or another town"
                )

    @property
    def places(self) -> tuple[tuple[str, int | None], ...]:
        """Towns of the trials that can be drawn, each with the seed of its scenery, in no particular order."""
        if self._trial is not None:
            return ((self._trial.town, self._trial.scenery),)
        if self._suite is not None:
            return tuple({(trial.town, trial.scenery) for trial in self._suite.trials})
        assert self._town is not None
        return ((self._town.name, self._town.scenery_seed),)

    def find(self, trial: Trial | str) -> Trial:
        """Return a trial by its id in the suite, or as it is. Raises UnknownTrialError; OptionError without a suite."""
        if isinstance(trial, Trial):
            return trial
        if self._suite is None:
            raise OptionError(f"trial: the id {trial!r} needs an environment that was made with its suite")
        return self._suite.trial(trial)

    def draw(self, random: np.random.Generator) -> Trial:
        """Return the next trial."""
        if self._trial is not None:
            return self._trial
        if self._suite is not None:
            episodes = self._suite.episodes
            return episodes[int(random.integers(len(episodes)))]
        if self._options.task is not None:
            return self._journey(random)
        approach = self._approaches[int(random.integers(len(self._approaches)))]
        seed = self._options.draw_seed(random)
        return self._made(approach, seed, self._options.draw_weather(random))

    def _journey(self, random: np.random.Generator) -> Trial:
        options, task = self._options, self._options.task
        assert self._town is not None
        assert task is not None
        weather = options.draw_weather(random)
        if task is Task.CRUISE:
            further = options.journeys or {}
            return draw_cruise(self._town, random, weather=weather, traffic=options.traffic, **further)
        seed = options.draw_seed(random)
        return draw_journey(self._town, task, seed, weather=weather, traffic=options.traffic, approach=options.approach)

    def _check_journeys(self) -> None:
        known = inspect.signature(draw_cruise).parameters.keys() - _NOT_OF_JOURNEYS
        for name in self._options.journeys or {}:
            if name not in known:
                raise OptionError(no_option(f"journeys.{name}", sorted(known)))
        try:
            self._journey(np.random.default_rng(0))
        except CruiseError as error:
            raise OptionError(f"journeys: {error}") from None
        except (AttributeError, TypeError, ValidationError) as error:  # of the wrong type, such as text
            reason = str(error).partition("\n")[0]
            raise OptionError(
                f"journeys: {self._options.journeys!r} has a value of the wrong type ({reason}); "
                "see wrongturn_networks.draw_cruise"
            ) from None

    def _made(self, approach: str, seed: int, weather: Weather) -> Trial:
        assert self._town is not None
        options = self._options
        return draw_trial(
            self._town, approach, options.fault, seed, route=options.route, weather=weather, traffic=options.traffic
        )

    def _suits(self, approach: str, *, among: int) -> bool:
        """Tell whether trials can be drawn at an approach; raise the reason why not if it is the only one."""
        try:
            check_fault(self._made(approach, 0, self._options.weathers[0]))
        except NetworkError:
            if among == 1:
                raise
            return False
        return True
