"""The study of failures: its words, its page, and when it is outdated."""

import hashlib
from pathlib import Path

import pytest
from made_results import keep, wrong_command

from wrongturn_agents.errors import OutdatedPageError
from wrongturn_agents.reporting.collection import Collection
from wrongturn_agents.reporting.failure_words import collisions_in_words, explanation, heading, shown, spread
from wrongturn_agents.reporting.failures import (
    Contact,
    Failures,
    Film,
    FilmedAgent,
    FilmedWay,
    MeasuredDrive,
    Measures,
    Other,
    check_films,
    failures_file,
    outdated,
    stored_results,
)
from wrongturn_agents.reporting.report import Report, write_page
from wrongturn_agents.reporting.weights import learned_agents, weights_sha256
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite

STRAIGHT_THROUGH = Measures(
    line_speed=8.0,
    slowest=6.0,
    steer_left=0.3,
    steer_right=0.25,
    beyond_grip_s=0.0,
    turn_begins=None,
    turned=4.0,
    past_middle=4.1,
    left=-1.0,
    end_speed=6.5,
    end_brake=0.0,
    opposed_m=0.0,
)
LATE = STRAIGHT_THROUGH.model_copy(update={"turn_begins": 9.0, "turned": -12.0, "line_speed": 7.0})
TWIN = STRAIGHT_THROUGH.model_copy(update={"turn_begins": 4.0, "turned": 90.0, "line_speed": 4.0, "past_middle": 2.0})


FILM = "ppo-image.left-right.omission.collision.none.webp"


@pytest.fixture
def collection(tmp_path: Path) -> Collection:
    """Results of an agent that fails twice, where no command tells it to turn."""
    stored = tmp_path / "stored"
    stored.mkdir()
    results = wrong_command("ppo-image", (0, 0, 0, 0, 0, 2), seed=1)
    return Collection.read(keep(stored, results, shipped={"ppo-image": 1}))


def filmed_of(collection: Collection, film: bytes = b"") -> FilmedAgent:
    """Return the agent's part of a study that fits its results."""
    ended = stored_results(collection, "ppo-image")
    assert ended is not None
    ((way, trials),) = ended.unsafe_ways().items()
    drives = tuple(
        MeasuredDrive(trial=name, own=own, twin=TWIN)
        for name, own in zip(trials, (STRAIGHT_THROUGH, LATE), strict=True)
    )
    made = FilmedWay(
        **way._asdict(),
        trials=trials,
        drives=drives,
        film=Film(file=way.film("ppo-image"), sha256=hashlib.sha256(film).hexdigest(), trial=trials[1]),
    )
    weights = weights_sha256("ppo-image")
    return FilmedAgent(weights_sha256=weights, secret=ended.secret, results=None, ways=(made,), journeys=())


def study_of(filmed: FilmedAgent) -> Failures:
    suite = installed_suite(WRONG_COMMAND)
    return Failures(suite=suite.id, suite_sha256=suite.sha256, thresholds=2, agents={"ppo-image": filmed})


def test_sentences_say_what_was_measured(collection):
    (way,) = filmed_of(collection).ways
    said = explanation(way)
    assert said.startswith("Without a command it comes too fast and turns too late. ")
    assert "crosses the stop line at 7.5 m/s (7.0–8.0), faster than with the right command: 4.0 m/s." in said
    assert "begins to turn 9.0 m past the stop line, 5.0 m later than with the right command. In 1 of 2" in said
    assert "It steers to one side and then to the other." in said
    assert heading(way.way) == "No command where roads lead left and right: hits something"
    assert way.film is not None
    alt = shown("ppo-image", way, way.film)
    assert "told nothing" in alt
    assert "it crosses the stop line at 7.0 m/s, turns 12° right and hits something." in alt


def test_a_drive_like_its_twin_is_not_called_fast_or_late(collection):
    (way,) = filmed_of(collection).ways
    alike = way.model_copy(update={"drives": (MeasuredDrive(trial="t", own=TWIN, twin=TWIN),)})
    said = explanation(alike)
    assert said.startswith("Without a command it misses its way. It crosses the stop line at 4.0 m/s, much as with")
    assert "later" not in said


def test_a_spread_names_its_range_only_if_there_is_one():
    assert spread([3.0, 5.0, 4.0], " m/s") == "4.0 m/s (3.0–5.0)"
    assert spread([4.04, 4.01], " m") == "4.0 m"


def test_collisions_are_counted_by_kind():
    ahead = Contact(
        other=Other.AHEAD, in_junction=False, speed=6.0, other_speed=0.0, in_view_s=4.0, brake=0.1, throttle=0.4
    )
    crossing = ahead.model_copy(update={"other": Other.CROSSING, "in_junction": True, "other_speed": 5.0})
    said = collisions_in_words([ahead, crossing, ahead])
    assert said.startswith("Twice it drives into a vehicle ahead, on a lane: at 6.0 m/s, the other at 0.0 m/s. ")
    assert "Once it hits a vehicle that comes from the side, in a junction" in said


def test_the_page_shows_counts_films_and_who_is_not_filmed(tmp_path, collection):
    page = tmp_path / "docs" / "failures.md"
    page.parent.mkdir()
    names = ("failure-counts", "failures", "collisions")
    page.write_text("".join(f"<!-- wrongturn results: {name} -->\n<!-- end of results -->\n" for name in names))
    study = study_of(filmed_of(collection))
    study.write(failures_file(tmp_path / "stored"))
    write_page(page, Report.read(tmp_path / "stored"))
    text = page.read_text()
    assert "| `ppo-image` | open | 0 · 0 | 0 · 0 | 0 · 2 | 2 |" in text
    assert "## ppo-image\n\n2 of 60 trials are unsafe.\n\n### No command where" in text
    assert "ppo-image.left-right.omission.collision.none.webp)\n\n**2 of 10.** " in text
    assert text.count("*Not filmed yet.*") == len(learned_agents()) - 1


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"weights_sha256": "0" * 64}, "its weights have changed"),
        ({"secret": "another"}, "its results have changed"),
        ({"ways": ()}, "its results have changed"),
    ],
)
def test_films_of_other_weights_or_results_are_outdated(tmp_path, collection, change, why):
    film = b"film"
    filmed = filmed_of(collection, film)
    (tmp_path / FILM).write_bytes(film)
    assert outdated(collection, "ppo-image", filmed) is None
    check_films(collection, study_of(filmed), tmp_path)
    with pytest.raises(OutdatedPageError, match=f"films of ppo-image: {why}; make them with"):
        check_films(collection, study_of(filmed.model_copy(update=change)), tmp_path)


def test_a_film_that_is_missing_or_left_over_is_named(tmp_path, collection):
    filmed = filmed_of(collection, b"film")
    with pytest.raises(OutdatedPageError, match=r"omission.collision.none.webp: is not the film that was made"):
        check_films(collection, study_of(filmed), tmp_path)
    (tmp_path / FILM).write_bytes(b"film")
    (tmp_path / "old.webp").write_bytes(b"film")
    with pytest.raises(OutdatedPageError, match=r"old.webp: no page shows it; delete it"):
        check_films(collection, study_of(filmed), tmp_path)
