"""Wrongturn's towns and suites."""

from wrongturn_networks.errors import (
    ApproachTooShortError,
    CorruptFileError,
    FaultNotApplicableError,
    NetworkError,
    RouteNotAvailableError,
    UnknownApproachError,
    UnknownSuiteError,
    UnknownTownError,
    UnknownTrialError,
)
from wrongturn_networks.junctions import Approach, Exit, Junction
from wrongturn_networks.lanes import Lane
from wrongturn_networks.loading import load_town, read_town, town_names
from wrongturn_networks.scenery import SceneryKind, SceneryObject
from wrongturn_networks.starts import draw_start, draw_trial
from wrongturn_networks.suites import Suite, load_suite, read_suite, suite_ids
from wrongturn_networks.town import Town

__all__ = [
    "Approach",
    "ApproachTooShortError",
    "CorruptFileError",
    "Exit",
    "FaultNotApplicableError",
    "Junction",
    "Lane",
    "NetworkError",
    "RouteNotAvailableError",
    "SceneryKind",
    "SceneryObject",
    "Suite",
    "Town",
    "UnknownApproachError",
    "UnknownSuiteError",
    "UnknownTownError",
    "UnknownTrialError",
    "draw_start",
    "draw_trial",
    "load_suite",
    "load_town",
    "read_suite",
    "read_town",
    "suite_ids",
    "town_names",
]
