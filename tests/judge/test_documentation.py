"""docs/verdicts.md shows the numbers and words that the judge uses."""

import dataclasses
import re
from pathlib import Path

import pytest

from wrongturn_judge import JOURNEY_THRESHOLDS, THRESHOLDS, JourneyThresholds, Thresholds
from wrongturn_protocol import STRICT_FLAGS, Flag, JourneyOutcome, Outcome, Reaction, Verdict

PAGE = (Path(__file__).parents[2] / "docs" / "verdicts.md").read_text(encoding="utf-8")


def section(title: str) -> str:
    return PAGE.split(f"\n## {title}\n")[1].split("\n## ")[0]


def shown(title: str) -> dict[str, str]:
    return dict(re.findall(r"^\| `(\w+)` \| ([\d.]+) \|", section(title), re.MULTILINE))


def values(thresholds: Thresholds) -> dict[str, str]:
    return {name: str(value) for name, value in dataclasses.asdict(thresholds).items()}


def test_the_page_shows_every_threshold() -> None:
    assert shown("Numbers") == values(THRESHOLDS)
    assert f"Version {THRESHOLDS.version}." in PAGE


def test_the_page_names_no_threshold_that_is_none() -> None:
    kinds = (Thresholds, JourneyThresholds)
    names = {field.name for kind in kinds for field in dataclasses.fields(kind)}
    used = set(re.findall(r"`([a-z]+(?:_[a-z]+)+)`", PAGE))
    words = {str(word) for kind in (Verdict, Flag, Reaction) for word in kind}
    assert used - names - words - set(JourneyOutcome.model_fields) - set(Outcome.model_fields) <= {"wrongturn_judge"}


def test_the_table_is_in_order_of_precedence_with_what_each_counts_as() -> None:
    rows = re.findall(r"^\| (`.*?`) \| .* \| (\S+) \| (\S+) \|$", section("Table"), re.MULTILINE)
    listed = [(Verdict(name), *counts) for names, *counts in rows for name in re.findall(r"`(\w+)`", names)]
    assert [verdict for verdict, *_ in listed] == list(Verdict)
    for verdict, paper, strict in listed:
        if verdict is Verdict.INVALID:
            continue
        assert paper == verdict.safety
        assert strict == ("unsafe" if verdict.unsafe_strict else verdict.safety)


def test_the_page_tells_how_journeys_end_and_what_is_counted() -> None:
    page = section("Journeys")
    assert re.findall(r"^\d\. `(\w+)`", page, re.MULTILINE) == ["collision", "arrived", "timeout"]
    assert set(re.findall(r"^\| `(\w+)` \|", page, re.MULTILINE)) == set(JourneyOutcome.model_fields)
    assert f"`back_time`, {JOURNEY_THRESHOLDS.back_time:g} s" in page
    assert f"oncoming lane for {JOURNEY_THRESHOLDS.wrong_way_time:g} s" in page
    assert f"{JOURNEY_THRESHOLDS.stand_time:g} s of standing" in page
    assert f"`stop_speed`, {JOURNEY_THRESHOLDS.stop_speed:g} m/s" in page
    assert {flag for flag in Flag if f"`{flag}`" in page} == {Flag.KERB_BITE, Flag.LANE_INVASION, Flag.WRONG_WAY}


def test_the_page_names_every_flag_figure_and_reaction() -> None:
    flags = set(re.findall(r"^\| `(\w+)` \|", section("Flags").split("| figure |")[0], re.MULTILINE))
    assert flags == STRICT_FLAGS
    figures = re.findall(r"^\| (`.*?`) \|", section("Flags").split("| figure |")[1], re.MULTILINE)
    others = {"verdict", "reaction", "flags", "exit", "time", "journey"}
    assert {name for names in figures for name in re.findall(r"`(\w+)`", names)} == set(Outcome.model_fields) - others
    assert {word for word in Reaction if f"`{word}`" in section("Reactions")} == set(Reaction)


@pytest.mark.parametrize("name", [field.name for field in dataclasses.fields(Thresholds)])
@pytest.mark.parametrize("value", [0, -1.0, float("nan"), float("inf")])
def test_a_threshold_must_be_positive_and_finite(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        dataclasses.replace(THRESHOLDS, **{name: value})


def test_a_threshold_must_be_in_its_range() -> None:
    with pytest.raises(ValueError, match="wheels_off"):
        Thresholds(wheels_off=5)
    for name in ("exit_heading", "across_heading"):
        with pytest.raises(ValueError, match=name):
            dataclasses.replace(THRESHOLDS, **{name: 181.0})
