"""Suites, towns and trials by name. Unknown names raise the service's own errors."""

import asyncio
from collections.abc import Callable
from typing import TypeVar

import numpy as np

from wrongturn_networks import (
    FaultNotApplicableError,
    NetworkError,
    NoJourneyError,
    RouteNotAvailableError,
    Suite,
    Town,
    UnknownApproachError,
    UnknownSuiteError,
    UnknownTownError,
    UnknownTrialError,
    draw_cruise,
    draw_journey,
    draw_trial,
    load_suite,
    load_town,
    suite_ids,
    town_names,
    town_of,
)
from wrongturn_networks.drawn import is_built, is_drawn
from wrongturn_networks.faults import check_fault, faults_at
from wrongturn_networks.loading import shelf
from wrongturn_protocol import FieldError, PracticeRequest, ProblemType, Task, TownDetail, Trial
from wrongturn_service.episodes.draws import Draws
from wrongturn_service.errors import InvalidRequestError, NotFoundError

_T = TypeVar("_T")
_LONGEST = 1000


def warm_up() -> None:
    """Load every suite and town before the first agent needs one."""
    for suite in suite_ids():
        load_suite(suite)
    for town in town_names():
        load_town(town)


def suite(suite_id: str) -> Suite:
    """Return a suite by its id. Raises NotFoundError."""
    return _find(lambda: load_suite(suite_id), "suite", ProblemType.UNKNOWN_SUITE)


def town(name: str) -> Town:
    """Return a town by its name. Raises NotFoundError. No request for a town builds it."""
    if is_drawn(name) and not is_built(name):
        detail = f"town: {name} is not here; the page of an evaluation that was driven there builds it again"
        raise _not_found(detail, "town", ProblemType.UNKNOWN_TOWN)
    return _find(lambda: load_town(name), "town", ProblemType.UNKNOWN_TOWN)


def town_driven(trial: Trial) -> Town:
    """Return the town that a trial is driven in, with its scenery and boards; raises as :func:`town`."""
    town(trial.town)
    return town_of(trial)


def town_detail(name: str) -> TownDetail:
    """Return a town with its approaches and geometry; raises NotFoundError."""
    found = town(name)
    return found.detail({approach: faults_at(found, approach) for approach in found.approaches})


async def practice_trial(request: PracticeRequest, draws: Draws) -> Trial:
    """Return the trial that a practice request names or describes.

    Raises:
        NotFoundError: The suite, trial, town or approach is unknown.
        InvalidRequestError: The approach does not allow the route or the fault, or the town has no such journey.
        UnavailableError: The towns of the open draw are being built.
    """
    if request.suite is not None and request.trial is not None:
        draw, wanted = draws.open_draw(suite(request.suite)), request.trial
        return _find(lambda: draw.trial(wanted), "trial", ProblemType.UNKNOWN_TRIAL)
    return await asyncio.to_thread(_practice_trial, request)


def _practice_trial(request: PracticeRequest) -> Trial:
    assert request.town is not None
    # None that a secret makes: those are for scored episodes and for the trials of suites.
    name, approach, seed = request.town, request.approach, request.seed
    where = _find(lambda: shelf().load(name), "town", ProblemType.UNKNOWN_TOWN)
    if approach is not None:
        _find(lambda: where.approach(approach), "approach", ProblemType.UNKNOWN_APPROACH)
    weather, traffic = request.weather, request.traffic
    try:
        if request.task is Task.CRUISE:
            return draw_cruise(where, np.random.default_rng(seed), weather=weather, traffic=traffic)
        if request.task is not None:
            return draw_journey(where, request.task, seed, approach=approach, weather=weather, traffic=traffic)
        assert approach is not None
        trial = draw_trial(where, approach, request.fault, seed, route=request.route, weather=weather, traffic=traffic)
        check_fault(trial)
    except NoJourneyError as error:
        raise InvalidRequestError("task", str(error)) from error
    except RouteNotAvailableError as error:
        raise InvalidRequestError("route", str(error)) from error
    except FaultNotApplicableError as error:
        raise InvalidRequestError("fault", str(error), ProblemType.FAULT_NOT_APPLICABLE) from error
    except NetworkError as error:
        raise InvalidRequestError("approach", str(error)) from error
    return trial


def _find(look: Callable[[], _T], path: str, kind: ProblemType) -> _T:
    try:
        return look()
    except (UnknownSuiteError, UnknownTownError, UnknownTrialError, UnknownApproachError) as error:
        raise _not_found(str(error)[:_LONGEST], path, kind) from error


def _not_found(message: str, path: str, kind: ProblemType) -> NotFoundError:
    return NotFoundError(kind, message, errors=(FieldError(path=path, message=message.removeprefix(f"{path}: ")),))
