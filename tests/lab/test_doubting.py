"""Figures of the doubting agents: cards and page agree with the shipped files."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("onnxruntime")

from lab import doubting_study as study
from lab.doubting_card import card
from lab.doubting_pages import FIGURES, filled, tables
from wrongturn_agents.doubting_agent import DOUBTING_AGENTS
from wrongturn_agents.onnx_agent import open_session
from wrongturn_protocol import Trial

DOCS = Path(__file__).parents[2] / "docs"
FIGURE: dict[str, Any] = {
    "algorithm": "doubting",
    "seed": 1,
    "variant": None,
    "gate": [],
    "town": "Town01",
    "weather": "ClearNoon",
    "secret": "a",
    "pictures": 5,
    "driver": "0a1b",
    "doubt": "9f8e",
    "unsafe_strict": 0,
    "trials": 60,
    "twins_completed": 60,
    "twins": 60,
    "reactions": {"infeasible overrode": 29, "infeasible froze": 1, "omission exit": 30},
}


@pytest.mark.parametrize("name", DOUBTING_AGENTS)
def test_the_card_is_the_one_that_the_files_make(name: str) -> None:
    agent = DOUBTING_AGENTS[name]
    assert agent.card.read_text("utf-8") == card(agent), "run python -m lab.doubting_card"
    assert "/work" not in agent.card.read_text("utf-8")


def test_the_page_has_the_stored_figures() -> None:
    page = (DOCS / "doubting.md").read_text("utf-8")
    figures = json.loads(FIGURES.read_text("utf-8"))
    assert filled(page, figures) == page, "run python -m lab.doubting_pages"
    assert {f"<!-- doubting: {name} -->" in page for name in tables(figures)} == {True}


@pytest.mark.parametrize("name", DOUBTING_AGENTS)
def test_the_figures_are_of_the_files_that_are_shipped(name: str) -> None:
    """Another driver behind the same gate drives otherwise, so its figures are driven anew; so does another gate."""
    agent = DOUBTING_AGENTS[name]
    seed = int(open_session(agent.file).get_modelmeta().custom_metadata_map["seed"])
    found = {
        (one["doubt"], one["driver"])
        for one in json.loads(FIGURES.read_text("utf-8"))
        if (one["algorithm"], one["seed"], one["gate"], one["variant"]) == (name, seed, [], None)
    }
    shipped = tuple(hashlib.sha256(file.read_bytes()).hexdigest() for file in agent.files)
    assert found == {shipped}, (
        f"{name} or {agent.drives} changed since {name} was driven: drive again with "
        "python -m lab.doubting_study, and read docs/doubting.md anew"
    )


def test_fresh_draws_belong_to_the_files_that_drive_and_are_driven_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file, driven = tmp_path / "figures.json", []

    def drives(_source: object, trials: Sequence[Trial], **_: object) -> list[object]:
        driven.append(trials)
        return []

    monkeypatch.setattr(study, "drive_in_process", drives)
    for draws in ("1", "2"):
        arguments = ["study", "doubting", "--town", "Town02", "--draws", draws, "--json", str(file)]
        monkeypatch.setattr("sys.argv", arguments)
        assert study.main() == 0
    kept = json.loads(file.read_text("utf-8"))
    gate, driver = (hashlib.sha256(one.read_bytes()).hexdigest() for one in DOUBTING_AGENTS["doubting"].files)
    assert [one["secret"] for one in kept] == [f"{gate} {driver} {number}" for number in (1, 2)]
    assert {(one["fresh"], one["seed"], one["town"], one["driver"]) for one in kept} == {(True, 3, "Town02", driver)}
    assert [{trial.town for trial in trials} for trials in driven] == [{"Town02"}] * 2
    assert driven[0] != driven[1]


def test_tables_count_each_draw_and_each_part_of_the_gate() -> None:
    figures = [
        FIGURE,
        {**FIGURE, "secret": "b", "unsafe_strict": 2},
        {**FIGURE, "secret": "c"},
        {**FIGURE, "secret": "own 1", "fresh": True, "unsafe_strict": 4},
        {**FIGURE, "secret": "own 2", "fresh": True, "twins_completed": 59},
        {**FIGURE, "weather": "SoftRainSunset", "unsafe_strict": 7},
        {**FIGURE, "secret": "wrong-command@2", "gate": ["omission=false"], "unsafe_strict": 11},
    ]
    made = tables(figures)
    assert made["drivers"].count("| `doubting` | `ppo-image` | `0a1b` |") == 1
    assert "| `doubting` | infeasible | 180 | overrode 174, froze 6 |" in made["reactions"]
    assert "| `doubting` | 1 | `0a1b` | 3 | 0 (2 times), 2 | 60 (3 times) | – | – | – |" in made["draws"]
    assert "| `doubting` | 1 | Town01 | ClearNoon | 2 | 0, 4 | 4 of 120 | 59, 60 | 119 of 120 |" in made["fresh"]
    assert "| `doubting` | 1 | Town01 | SoftRainSunset | 7 | 60 |" in made["weathers"]
    assert "| `doubting` | 1 | `0a1b` | replaces missing exits only | 11 | 60 | – | – |" in made["ablation"]
