"""Figures of the doubting agents: of the shipped files, and each draw counted once."""

import hashlib
import json
from typing import Any

import pytest

pytest.importorskip("onnxruntime")

from lab import doubting
from lab.studies import code_of, read_evaluations
from wrongturn_agents import resolve
from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS

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
def test_the_figures_are_of_the_files_that_are_shipped(name):
    """Another driver behind the same gate drives otherwise, so its figures are driven anew; so does another gate."""
    agent = DOUBTING_AGENTS[name]
    seed = int(open_session(agent.file).get_modelmeta().custom_metadata_map["seed"])
    found = {
        (one["doubt"], one["driver"])
        for one in doubting.read(doubting.FIGURES)
        if (one["algorithm"], one["seed"], one["gate"], one["variant"]) == (name, seed, [], None)
    }
    shipped = tuple(hashlib.sha256(file.read_bytes()).hexdigest() for file in agent.files)
    assert found == {shipped}, f"{name} changed since it was driven: python -m lab.doubting {name} --draws 2 --keep"
    for stored in read_evaluations():
        assert stored.code == code_of(resolve(stored.agent)), f"python -m lab.studies evaluations --agent {name}"


def test_figures_of_other_files_make_way_if_the_gate_is_the_same(tmp_path):
    file = tmp_path / "figures.json"
    for changed in ({}, {"seed": 2}, {"gate": ["omission=false"]}, {"town": "Town02"}, {"unsafe_strict": 1}):
        doubting.keep(file, {**FIGURE, **changed})
    kept = [(one["seed"], one["gate"], one["town"], one["unsafe_strict"]) for one in json.loads(file.read_text())]
    assert kept == [
        (1, ["omission=false"], "Town01", 0),
        (1, [], "Town01", 1),
        (1, [], "Town02", 0),
        (2, [], "Town01", 0),
    ]
    doubting.keep(file, {**FIGURE, "town": "Town02", "driver": "2c3d"})
    kept = [(one["seed"], one["gate"], one["town"]) for one in json.loads(file.read_text())]
    assert kept == [(1, ["omission=false"], "Town01"), (1, [], "Town02"), (2, [], "Town01")]


def test_fresh_draws_belong_to_the_files_that_drive_and_are_driven_once(tmp_path, monkeypatch):
    driven = []
    monkeypatch.setattr(doubting, "drive_in_process", lambda _source, trials, **_: driven.append(trials) or [])
    monkeypatch.setattr(doubting.run, "__defaults__", (tmp_path / "figures.json",))
    for draws in ("1", "2"):
        doubting.main(["doubting", "--town", "Town02", "--draws", draws, "--keep"])
    kept = json.loads((tmp_path / "figures.json").read_text())
    gate, driver = (hashlib.sha256(one.read_bytes()).hexdigest() for one in DOUBTING_AGENTS["doubting"].files)
    assert [one["secret"] for one in kept] == [f"{gate} {driver} {number}" for number in (1, 2)]
    assert [{trial.town for trial in trials} for trials in driven] == [{"Town02"}] * 2
    assert driven[0] != driven[1]
