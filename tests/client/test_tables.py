"""The paper's layout."""

import io
from typing import Any

import pytest
from rich.console import Console
from rich.table import Table

from wrongturn_client.listings import listing_table
from wrongturn_client.tables import breakdown_table, comparison_table, evaluation_table, leaderboard_table, standing
from wrongturn_protocol import Comparison, Leaderboard, Metrics

CELL = {"infeasible": {"unsafe": 7, "trials": 10}, "omission": {"unsafe": 1, "trials": 10}}
COUNT = {"count": 12, "trials": 60, "rate": 0.2, "ci95": [0.118, 0.318]}
STRICT = {"infeasible": {"unsafe": 9, "trials": 10}, "omission": {"unsafe": 2, "trials": 10}}
TYPES = ("STRAIGHT_LEFT", "STRAIGHT_RIGHT", "LEFT_RIGHT")
METRICS: dict[str, Any] = {
    "unsafe": COUNT,
    "unsafe_strict": {**COUNT, "count": 15, "rate": 0.25, "ci95": [0.158, 0.372]},
    "twins": {"unsafe": 0, "completed": 58, "trials": 60},
    "excess_unsafe_rate": {"value": 0.2, "ci95": [0.1, 0.3], "p": 0.0005},
    "table": dict.fromkeys(TYPES, CELL),
    "table_strict": dict.fromkeys(TYPES, STRICT),
    "reactions": {},
    "verdicts": {},
}


def _entry(name: str, rank: int | None, **more: Any) -> dict[str, Any]:
    agent = {"id": name, "name": name, "track": "privileged", "kind": "baseline"}
    entry = {"rank": rank, "tied_with": [], "eligible": rank is not None, "why_not": None, "agent": agent}
    return {**METRICS, **entry, "entry": "remote", "evaluation": "e", **more}


def _leaderboard(*entries: dict[str, Any]) -> Leaderboard:
    board = {"suite": "wrong-command@3", "sha256": "0" * 64, "updated": None, "entries": entries}
    return Leaderboard.model_validate(board)


def _shown(table: Table, width: int = 120) -> str:
    output = io.StringIO()
    Console(width=width, file=output, color_system=None).print(table)
    return "\n".join(line.rstrip() for line in output.getvalue().splitlines())


def _joined(line: str) -> str:
    return " ".join(line.split())


def _words(line: str) -> list[str]:
    return [word.strip() for word in line.split("  ") if word.strip()]


def test_leaderboard_has_a_row_for_each_fault_of_each_agent() -> None:
    board = _leaderboard(_entry("careful", 1, tied_with=["other"]), _entry("parked", None, why_not="not engaged"))
    lines = _shown(leaderboard_table(board)).splitlines()
    assert _joined(lines[1]) == "straight straight left or"
    assert _joined(lines[2]) == "rank agent fault or left or right right strict paper's twins"
    row = lines.index(next(line for line in lines if "careful" in line))
    assert _joined(lines[row]) == "1= careful infeasible 9/10 9/10 9/10 15/60 25 % 12/60 58/60"
    assert _joined(lines[row + 1]) == "privileged omission 2/10 2/10 2/10 [16, 37] %"
    assert any(line.split()[:2] == ["–", "parked"] for line in lines)
    assert "parked is not ranked: not engaged" in "\n".join(lines)


def test_owners_are_named_where_they_are_not_the_agent() -> None:
    mine, own = _entry("mine", 1), _entry("own", 1)
    mine["agent"] = {**mine["agent"], "owner": "ACME"}
    own["agent"] = {**own["agent"], "owner": "own"}
    lines = _shown(leaderboard_table(_leaderboard(mine, own))).splitlines()
    row = lines.index(next(line for line in lines if " mine " in line))
    assert lines[row + 1].split()[0] == "privileged"
    assert _words(lines[row + 2]) == ["by ACME"]
    assert "by own" not in "\n".join(lines)


def test_who_met_wrong_commands_in_training_is_marked() -> None:
    doubting, other = _entry("doubting", 1), _entry("other", 2)
    doubting["agent"] = {**doubting["agent"], "trained_on_faults": True}
    lines = _shown(leaderboard_table(_leaderboard(doubting, other))).splitlines()
    assert next(line for line in lines if " doubting" in line).split()[1:3] == ["doubting", "†"]
    assert next(line for line in lines if " other" in line).split()[1:3] == ["other", "infeasible"]
    assert "† met wrong commands in its training." in lines
    assert "†" not in _shown(leaderboard_table(_leaderboard(other)))


def test_what_was_handed_in_as_a_file_is_marked() -> None:
    shown = _shown(leaderboard_table(_leaderboard({**_entry("file", 1), "entry": "uploaded"}, _entry("other", 2))))
    assert "file ‡" in shown
    assert shown.count("‡") == 2
    assert "‡ was handed in as a file, and the service drove it." in shown.splitlines()


def test_an_algorithm_is_marked_and_has_its_range() -> None:
    spread = {"median": 15, "lowest": 9, "highest": 31}
    seeds = {"count": 5, "unsafe": spread, "unsafe_strict": spread, "twins_completed": spread}
    ppo = _entry("ppo", None, why_not="A row over 5 training seeds.", seeds=seeds, evaluation=None)
    ppo |= {"agent": {**ppo["agent"], "kind": "algorithm"}, "entry": None}
    lines = _shown(leaderboard_table(_leaderboard(ppo))).splitlines()
    row = lines.index(next(line for line in lines if " ppo " in line))
    assert lines[row].split()[:2] == ["–", "ppo"]
    assert lines[row + 1].endswith("seeds 9–31")
    assert lines[row + 2].split() == ["5", "training", "seeds"]
    assert "ppo is not ranked: A row over 5 training seeds." in lines


def test_agents_without_a_rank_for_the_same_reason_are_named_together() -> None:
    board = _leaderboard(*(_entry(name, None, why_not="Too few twins.") for name in ("a", "b")))
    lines = _shown(leaderboard_table(board)).splitlines()
    assert "a, b are not ranked: Too few twins." in lines


def test_a_place_is_a_sentence() -> None:
    mine = _entry("mine", 2, evaluation="mine")
    useless = _entry("useless", None, why_not="Completed 0 of 60 twins, at least 54 are needed.", evaluation="useless")
    board = _leaderboard(_entry("best", 1), mine, useless)
    figures = "unsafe 15 of 60 (strict), 95 % interval 16 to 37 %."
    assert standing(board, "mine") == f"Rank 2 of 2 in the privileged track; {figures}"
    for others, words in ((["best"], "best"), (["best", "b"], "best and b"), (["best", "b", "c"], "best, b and c")):
        tied = _leaderboard(_entry("mine", 1, evaluation="mine", tied_with=others))
        assert standing(tied, "mine") == f"Rank 1 of 1 in the privileged track, tied with {words}; {figures}"
    assert standing(board, "useless") == "Not ranked: Completed 0 of 60 twins, at least 54 are needed."
    assert standing(board, "second try") == "Another evaluation of this agent is its entry on the leaderboard."


def test_a_comparison_shows_each_stratum_and_what_it_says() -> None:
    cells = {"a": {"unsafe": 1, "trials": 10}, "b": {"unsafe": 7, "trials": 10}}
    found = Comparison.model_validate(
        {
            "suite": "wrong-command@3",
            "a": _entry("[mine]", 1)["agent"],
            "b": _entry("careful", 1)["agent"],
            "strata": [
                {"junction_type": "STRAIGHT_LEFT", "fault": "infeasible", **cells},
                {"task": "one_turn", "condition": "new_town", **cells},
            ],
            "total_a": {"unsafe": 2, "trials": 20},
            "total_b": {"unsafe": 14, "trials": 20},
            "difference": -0.6,
            "p": 0.001,
            "sentence": "It is significant.",
        }
    )
    rows = [_words(line) for line in _shown(comparison_table(found)).splitlines()]
    assert ["stratum", "[mine]", "careful"] in rows
    assert ["straight or left, infeasible", "1/10", "7/10"] in rows
    assert ["one turn, new town", "1/10", "7/10"] in rows
    assert ["all", "2/20", "14/20"] in rows
    assert rows[-1] == ["It is significant."]


@pytest.mark.parametrize("name", ["a", "ignores-commands", "an agent with a rather long name"])
def test_words_and_counts_stay_whole_at_80_columns(name: str) -> None:
    shown = _shown(leaderboard_table(_leaderboard(_entry(name, 1))), width=80)
    assert {"straight", "privileged", "infeasible", "9/10", "12/60", "58/60", "twins"} <= set(shown.split())


def test_towns_stay_readable_at_80_columns() -> None:
    towns = [{"name": "Town01", "sha256": "0" * 64, "junctions": 12, "approaches": {"STRAIGHT_LEFT": 11}}]
    assert "…" not in _shown(listing_table("towns", towns), width=80)


def test_an_empty_leaderboard_repeats_the_url_in_its_commands() -> None:
    shown = _shown(leaderboard_table(_leaderboard(), ["wrong-command@3"], "http://[::1]:8000")).splitlines()
    assert "wrongturn leaderboard wrong-command@3 --url 'http://[::1]:8000'" in shown
    assert "wrongturn leaderboard smoke@3" in _shown(leaderboard_table(_leaderboard(), ["smoke@3"])).splitlines()


def test_an_agents_name_is_no_markup() -> None:
    board = _leaderboard(_entry("[red]me[", 1), _entry("b", None, why_not="[bold]"))
    shown = _shown(leaderboard_table(board))
    assert "[red]me[" in shown
    assert "b is not ranked: [bold]" in shown


COMPLIED = {"count": 3, "trials": 5, "rate": 0.6, "ci95": [0.2, 0.9]}


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        ({}, ["infeasible", "omission", "15/60 25 %", "[16, 37] %", "12/60", "58/60", "p = 0.0005"]),
        ({}, ["9/10", "\nunsafe beyond the twins: +20 points, 95 % [+10, +30], p = 0.0005"]),
        ({"table_strict": {"CROSS": {"stuck": {"unsafe": 1, "trials": 2}}}}, ["crossing", "stuck", "1/2"]),
        ({"table": {}, "table_strict": None}, ["infeasible", "–"]),
        ({"compliance": {**COMPLIED, "faults": {"stuck": COMPLIED}}}, ["complied with 3 of 5", "commands: stuck 3/5"]),
    ],
)
def test_an_evaluation_has_the_same_layout(change: dict[str, Any], seen: list[str]) -> None:
    shown = _shown(evaluation_table("me [x]", Metrics.model_validate({**METRICS, **change})))
    assert "me [x]: unsafe trials" in shown
    for words in seen:
        assert words in shown


def test_a_breakdown_has_a_row_for_each_level() -> None:
    level = {"count": 3, "trials": 8, "rate": 0.375, "ci95": [0.14, 0.69], "completed": 7}
    factors = {"dose": {"late 5 m": level}, "town": {"Town01": level}, "paper_cells": {"omission LEFT_RIGHT": level}}
    table = breakdown_table("me [x]", Metrics.model_validate({**METRICS, "breakdown": factors}))
    shown = [line.split() for line in _shown(table, width=80).splitlines()]
    figures = ["3/8", "38", "%", "[14,", "69]", "%", "7/8"]
    for words in (
        ["dose", "late,", "5", "m"],
        ["town", "Town01"],
        ["paper", "cells", "omission,", "left", "or", "right"],
    ):
        assert [*words, *figures] in shown
    assert breakdown_table("me", Metrics.model_validate(METRICS)) is None


def _count(success: int, clean: int) -> dict[str, Any]:
    rates = {"off_road": 0.125, "wrong_lane": 0.25, "collisions": 0.0}
    figures = {"rate": success / 25, "ci95": [0.7, 0.95], "completion": 0.9, "distance": 12.5, "per_km": rates}
    return {"episodes": 25, "success": success, "clean": clean, **figures}


NAVIGATION = {
    "total": _count(22, 19),
    "table": {
        "straight": {"training": _count(25, 24), "new_town_and_weather": _count(23, 21)},
        "navigation_dynamic": {"training": _count(13, 5)},
    },
}
OF_JOURNEYS = {**METRICS, "table": {}, "table_strict": None, "excess_unsafe_rate": None, "navigation": NAVIGATION}


def test_journeys_have_corl_s_table() -> None:
    lines = _shown(evaluation_table("me", Metrics.model_validate(OF_JOURNEYS))).splitlines()
    assert lines[0] == "me: journeys that reached their goal, in %"
    assert [line.split() for line in lines if line.startswith(("straight", "navigation"))] == [
        ["straight", "100", "96", "92", "84"],
        ["navigation", "with", "traffic", "52", "20", "–", "–"],
    ]
    shown = " ".join(lines)
    assert "22 of 25 reached their goal, 95 % interval [70, 95] %; 19 without any infraction; 90 % of the way" in shown
    assert "12.5 km: 0.12 times off the road, 0.25 in an oncoming lane, 0.00 collisions" in shown


def test_who_did_not_move_has_no_rates() -> None:
    still = {**_count(0, 0), "distance": 0.0, "per_km": None}
    metrics = Metrics.model_validate({**OF_JOURNEYS, "navigation": {"total": still, "table": {"straight": {}}}})
    assert "km" not in _shown(evaluation_table("parked", metrics))


def test_a_leaderboard_of_journeys_has_a_row_for_each_task() -> None:
    one = _entry("careful", 1, **{**OF_JOURNEYS, "tied_with": ["other"]})
    two = _entry("an-agent-with-a-rather-long-name", 1, **OF_JOURNEYS)
    for width in (80, 132):
        lines = _shown(leaderboard_table(_leaderboard(one, two)), width).splitlines()
        assert lines[0] == "wrong-command@3: journeys that reached their goal, in %"
        at = next(number for number, line in enumerate(lines) if "careful" in line)
        assert lines[at].split() == ["1=", "careful", "straight", "100", "92", "22/25", "88", "%", "76", "%"]
        assert lines[at + 1].split()[:2] == ["privileged", "navigation"]
        assert lines[at + 1].split()[-5:] == ["52", "–", "[70,", "95]", "%"]


def test_all_of_navigation_fits_into_80_columns() -> None:
    table = {
        task: dict.fromkeys(("training", "new_weather", "new_town", "new_town_and_weather"), _count(25, 25))
        for task in ("straight", "one_turn", "navigation", "navigation_dynamic")
    }
    total = {**_count(25, 25), "episodes": 400, "success": 400, "clean": 400}
    metrics = {**OF_JOURNEYS, "navigation": {"total": total, "table": table}}
    for shown in (
        _shown(evaluation_table("me", Metrics.model_validate(metrics)), 80),
        _shown(leaderboard_table(_leaderboard(_entry("ignores-commands", 1, **metrics))), 80),
    ):
        assert "…" not in shown
        assert {"navigation", "traffic", "weather", "clean"} <= set(shown.split())
