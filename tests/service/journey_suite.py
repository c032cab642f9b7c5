"""A suite of six journeys, made by hand and put among those that are installed."""

from pathlib import Path

import pytest

from wrongturn_networks import draw_journey, load_town, suites
from wrongturn_networks.making import write_suite
from wrongturn_protocol import Task, Track, Trial, Weather

SUITE = "journeys@1"
DRAWS = [
    ("Town01", Task.STRAIGHT, 1, Weather.CLEAR_NOON),
    ("Town01", Task.STRAIGHT, 2, Weather.WET_CLOUDY_NOON),
    ("Town01", Task.NAVIGATION, 3, Weather.CLEAR_SUNSET),
    ("Town01", Task.NAVIGATION, 4, Weather.HARD_RAIN_NOON),
    ("Town02", Task.STRAIGHT, 5, Weather.CLEAR_NOON),
    ("Town02", Task.NAVIGATION, 6, Weather.SOFT_RAIN_SUNSET),
]


def journeys() -> tuple[Trial, ...]:
    """Its trials."""
    return tuple(draw_journey(load_town(town), task, seed, weather=weather) for town, task, seed, weather in DRAWS)


def put_among_the_suites(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the suites be those that are installed, and this one."""
    file = folder / f"{SUITE}.json"
    write_suite(file, "Six journeys", journeys(), (Track.CAMERA, Track.PRIVILEGED))
    monkeypatch.setitem(suites.shelf()._shipped, SUITE, file)
