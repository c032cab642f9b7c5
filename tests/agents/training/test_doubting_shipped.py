"""The shipped doubting agents: their files fit, and they keep to roads that exist."""

from pathlib import Path

import pytest

pytest.importorskip("onnxruntime")

from wrongturn_agents.training.in_process import drive_in_process

from wrongturn_agents import resolve
from wrongturn_agents.errors import ModelFileError
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS
from wrongturn_networks import load_suite
from wrongturn_protocol import Reaction, Track, Verdict

TRACKS = {"doubting": Track.CAMERA, "doubting-segmentation": Track.SEGMENTATION}


@pytest.mark.parametrize("name", DOUBTING_AGENTS)
def test_it_is_an_agent_of_its_drivers_track(name: str) -> None:
    source = resolve(name)
    assert (source.name, source.track, source.trained_on_faults) == (name, TRACKS[name], True)
    assert source.make().name == name


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


def test_missing_weights_are_told_with_the_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("wrongturn_agents.shipped_agents.WEIGHTS", tmp_path)
    with pytest.raises(ModelFileError, match=r"ships no weights of it; train it .*train doubting --seed 1"):
        resolve("doubting").make()


def test_broken_weights_are_told_with_the_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("wrongturn_agents.shipped_agents.WEIGHTS", tmp_path)
    (tmp_path / "doubting.gate.onnx").write_text("not a model")
    with pytest.raises(ModelFileError, match="weights of doubting are broken; install wrongturn-agents again"):
        resolve("doubting").make()
