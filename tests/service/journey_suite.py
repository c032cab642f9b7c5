"""A suite of six journeys, made by hand and put among those that are installed."""

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from wrongturn_networks import draw_journey, load_town, suites
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
    shutil.copytree(suites.SUITES, folder)
    name, _, version = SUITE.partition("@")
    content = {
        "name": name,
        "version": int(version),
        "title": "Six journeys",
        "tracks": [Track.CAMERA.value, Track.PRIVILEGED.value],
        "trials": [trial.model_dump(mode="json") for trial in journeys()],
    }
    sha256 = hashlib.sha256(suites.canonical(content)).hexdigest()
    (folder / f"{SUITE}.json").write_text(json.dumps({**content, "sha256": sha256}))
    monkeypatch.setattr(suites, "SUITES", folder)
