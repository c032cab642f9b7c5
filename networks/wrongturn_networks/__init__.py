"""Wrongturn's towns and suites of trials."""

from wrongturn_networks.bends import Bend, bends_of
from wrongturn_networks.cruises import draw_cruise
from wrongturn_networks.errors import (
    ApproachTooShortError,
    CorruptFileError,
    CruiseError,
    FaultNotApplicableError,
    NetworkError,
    NoJourneyError,
    RouteNotAvailableError,
    UnknownApproachError,
    UnknownLaneError,
    UnknownSuiteError,
    UnknownTownError,
    UnknownTrialError,
)
from wrongturn_networks.journeys import draw_journey
from wrongturn_networks.junctions import Approach, Exit, Junction
from wrongturn_networks.lanes import Lane
from wrongturn_networks.loading import load_town, read_town, town_names
from wrongturn_networks.scenery import SceneryKind, SceneryObject
from wrongturn_networks.starts import draw_start, draw_trial
from wrongturn_networks.suites import Suite, load_suite, read_suite, suite_ids
from wrongturn_networks.town import Town
from wrongturn_networks.ways import Way, exits_towards, ways_to

__all__ = [
    "Approach",
    "ApproachTooShortError",
    "Bend",
    "CorruptFileError",
    "CruiseError",
    "Exit",
    "FaultNotApplicableError",
    "Junction",
    "Lane",
    "NetworkError",
    "NoJourneyError",
    "RouteNotAvailableError",
    "SceneryKind",
    "SceneryObject",
    "Suite",
    "Town",
    "UnknownApproachError",
    "UnknownLaneError",
    "UnknownSuiteError",
    "UnknownTownError",
    "UnknownTrialError",
    "Way",
    "bends_of",
    "draw_cruise",
    "draw_journey",
    "draw_start",
    "draw_trial",
    "exits_towards",
    "load_suite",
    "load_town",
    "read_suite",
    "read_town",
    "suite_ids",
    "town_names",
    "ways_to",
]
