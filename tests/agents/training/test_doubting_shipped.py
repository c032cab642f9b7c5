"""The shipped doubting agents: their files, cards and page agree, and they keep to roads that exist."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("onnxruntime")

from wrongturn_agents import resolve
from wrongturn_agents.doubting_agent import DOUBTING_AGENTS
from wrongturn_agents.errors import ModelFileError
from wrongturn_agents.onnx_agent import open_session
from wrongturn_agents.training.doubting import study
from wrongturn_agents.training.doubting.card import card
from wrongturn_agents.training.doubting.config import driver_of
from wrongturn_agents.training.doubting.pages import FIGURES, filled, tables
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.in_process import drive_in_process
from wrongturn_networks import load_suite
from wrongturn_protocol import Reaction, Track, Trial, Verdict

DOCS = Path(__file__).parents[3] / "docs"
TRACKS = {"doubting": Track.CAMERA, "doubting-segmentation": Track.SEGMENTATION}
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
def test_it_is_an_agent_of_its_drivers_track(name: str) -> None:
    source = resolve(name)
    assert (source.name, source.track, source.trained_on_faults) == (name, TRACKS[name], True)
    assert source.make().name == name


@pytest.mark.parametrize("name", DOUBTING_AGENTS)
def test_the_card_is_the_one_that_the_files_make(name: str) -> None:
    agent = DOUBTING_AGENTS[name]
    assert agent.card.read_text("utf-8") == card(agent), "run python -m wrongturn_agents.training.doubting.card"
    assert "/work" not in agent.card.read_text("utf-8")


def test_the_page_has_the_stored_figures() -> None:
    page = (DOCS / "doubting.md").read_text("utf-8")
    figures = json.loads(FIGURES.read_text("utf-8"))
    assert filled(page, figures) == page, "run python -m wrongturn_agents.training.doubting.pages"
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
        "python -m wrongturn_agents.training.doubting.study, and read docs/doubting.md anew"
    )


@pytest.mark.slow
def test_the_sister_overrides_what_the_road_does_not_offer() -> None:
    """The open draw's first infeasible trial and first omission of each junction type."""
    draw = load_suite("smoke@2").open_draw
    driven = {one.trial.id: one.outcome for one in drive_in_process(resolve("doubting-segmentation"), draw.trials)}
    for trial in draw.trials:
        outcome = driven[trial.id]
        assert outcome is not None
        assert outcome.verdict in {Verdict.EXIT_ROUTE, Verdict.EXIT_OTHER}
        assert outcome.reaction in {Reaction.OVERRODE, Reaction.EXIT}


def test_figures_of_the_same_drives_replace_each_other(tmp_path: Path) -> None:
    file = tmp_path / "figures.json"
    study.keep(file, FIGURE)
    study.keep(file, {**FIGURE, "town": "Town02", "unsafe_strict": 3})
    study.keep(file, {**FIGURE, "unsafe_strict": 1})
    kept = json.loads(file.read_text("utf-8"))
    assert [(one["town"], one["unsafe_strict"]) for one in kept] == [("Town01", 1), ("Town02", 3)]


@pytest.mark.parametrize("changed", ["driver", "doubt"])
def test_figures_of_other_files_make_way_if_the_gate_is_the_same(tmp_path: Path, changed: str) -> None:
    file = tmp_path / "figures.json"
    study.keep(file, FIGURE)
    study.keep(file, {**FIGURE, "seed": 2})
    study.keep(file, {**FIGURE, "gate": ["omission=false"]})
    study.keep(file, {**FIGURE, "algorithm": "doubting-segmentation"})
    study.keep(file, {**FIGURE, "town": "Town02", changed: "2c3d"})
    kept = json.loads(file.read_text("utf-8"))
    assert [(one["algorithm"], one["seed"], one["gate"], one["town"], one[changed] == "2c3d") for one in kept] == [
        ("doubting", 1, ["omission=false"], "Town01", False),
        ("doubting", 1, [], "Town02", True),
        ("doubting", 2, [], "Town01", False),
        ("doubting-segmentation", 1, [], "Town01", False),
    ]


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


def test_figures_of_two_drivers_are_told_apart() -> None:
    made = tables([FIGURE, {**FIGURE, "seed": 2, "driver": "2c3d"}])
    assert [row for row in ("0a1b", "2c3d") if f"| `ppo-image` | `{row}` |" in made["drivers"]] == ["0a1b", "2c3d"]
    assert "| `doubting` | 1 | `0a1b` | 1 |" in made["draws"]
    assert "| `doubting` | 2 | `2c3d` | 1 |" in made["draws"]


def test_a_table_without_figures_says_so() -> None:
    assert tables([FIGURE])["weathers"] == "*Not driven with these drivers yet.*"


def test_figures_name_the_file_that_drives(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("wrongturn_agents.shipped_agents.WEIGHTS", tmp_path)
    (tmp_path / "ppo-image.onnx").write_bytes(b"one")
    before = driver_of("doubting")
    (tmp_path / "ppo-image.onnx").write_bytes(b"another")
    assert before != driver_of("doubting") == hashlib.sha256(b"another").hexdigest()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--town", "Nowhere"], "Nowhere"),
        (["--town", "Town01", "--town", ""], "town"),
        (["--weather", "Foggy"], "--weather: there is no 'Foggy'; choose one of ClearNoon"),
        (["--draws", "-1"], "--draws: is -1"),
        (["--draws", "0"], "--draws: is 0; give a number of draws, 1 or more"),
        (["--threads", "0"], "threads: is 0"),
        (["--json", "missing/figures.json"], "--json: missing/figures.json cannot be written"),
        (["--json", "."], "--json: . cannot be written"),
    ],
)
def test_a_wrong_argument_is_named_before_anything_is_driven(
    arguments: list[str], says: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["study", "doubting", *arguments])
    assert study.main() == 1
    assert says in capsys.readouterr().err


@pytest.mark.parametrize("text", ["", "[1]", "null", '{"trials": 1}', "no json"])
def test_a_file_of_something_else_is_not_overwritten(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "figures.json"
    file.write_text(text)
    monkeypatch.setattr("sys.argv", ["study", "doubting", "--json", str(file)])
    assert study.main() == 1
    assert f"--json: {file} has no figures of this study" in capsys.readouterr().err
    assert file.read_text() == text


@pytest.mark.parametrize("agent", ["ppo-image", "doubtin"])
def test_an_agent_that_does_not_doubt_is_told_those_that_do(
    agent: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["study", agent])
    assert study.main() == 1
    assert f"agent: {agent!r} is no doubting agent; choose doubting or doubting-segmentation" in capsys.readouterr().err


def test_the_gate_of_a_shipped_agent_is_as_it_is(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["study", "doubting", "--gate", "memory=false"])
    assert study.main() == 1
    assert "--gate: a shipped agent has its gate; name a checkpoint" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["belief", "memory=perhaps", "begin=near", "unknown=1"])
def test_a_wrong_setting_of_the_gate_is_named(option: str) -> None:
    with pytest.raises(TrainingError, match="--gate"):
        study.gate_of([option])


def test_a_setting_of_the_gate_is_taken() -> None:
    config = study.gate_of(["memory=false", "begin=12"])
    assert (config.memory, config.begin, config.infeasible) == (False, 12.0, True)


def test_missing_weights_are_told_with_the_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("wrongturn_agents.doubting_agent.WEIGHTS", tmp_path)
    with pytest.raises(ModelFileError, match=r"ships no weights of it; train it .*train doubting --seed 1"):
        resolve("doubting").make()


def test_broken_weights_are_told_with_the_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("wrongturn_agents.doubting_agent.WEIGHTS", tmp_path)
    (tmp_path / "doubting.gate.onnx").write_text("not a model")
    with pytest.raises(ModelFileError, match="weights of doubting are broken; install wrongturn-agents again"):
        resolve("doubting").make()


def test_a_study_of_nothing_says_so(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["study", "missing.pt"])
    assert study.main() == 1
    assert "missing.pt: there is no such file" in capsys.readouterr().err
