"""A card says what its file and the stored results say."""

import hashlib
import json

import pytest

pytest.importorskip("onnxruntime")
pytest.importorskip("scipy")

from tiny_onnx import write_concat_model

from lab.cards import FACTS, cards
from wrongturn_agents.errors import ModelFileError
from wrongturn_agents.results_file import ResultsFile, TrialResult
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite
from wrongturn_protocol import FaultKind, Verdict

METADATA = {
    "name": "ppo-image",
    "track": "camera",
    "seed": "3",
    "steps": "3200000",
    "precision": "int8",
    "licence": "Apache-2.0",
    "config": "{}",
    "evaluation": json.dumps({"success": 0.96, "journeys": 50}),
    "versions": json.dumps({"torch": "2.13.0"}),
    "agreement": json.dumps({"mean": [0.004, 0.001, 0.002], "greatest": [0.05, 0.01, 0.02], "observations": 200}),
}


@pytest.fixture
def weights(tmp_path, monkeypatch):
    folder = tmp_path / "weights"
    folder.mkdir()
    write_concat_model(folder / "ppo-image.onnx", ("steering", "speed", "speed"), metadata=METADATA)
    (folder / FACTS).write_text(json.dumps({"ppo-image": {"hardware": "one GPU", "options": "--minutes 5"}}))
    monkeypatch.setattr("wrongturn_agents.shipped_agents.WEIGHTS", folder)
    return folder


@pytest.fixture
def results(tmp_path):
    """12 of the trials unsafe, all but two twins completed."""
    folder = tmp_path / "results"
    (folder / "curves").mkdir(parents=True)
    suite = installed_suite(WRONG_COMMAND)
    wrong = sorted(name for name, trial in suite.trials.items() if trial.fault.kind is not FaultKind.NONE)
    verdicts = dict.fromkeys(suite.trials, Verdict.EXIT_COMMANDED)
    verdicts |= dict.fromkeys(wrong, Verdict.EXIT_ROUTE) | dict.fromkeys(wrong[:12], Verdict.COLLISION)
    twins = sorted(suite.trials.keys() - set(wrong))
    verdicts |= dict.fromkeys(twins[:2], Verdict.OFF_ROAD)
    ResultsFile(
        agent="ppo-image",
        seed=3,
        suite=suite.id,
        suite_sha256=suite.sha256,
        secret=suite.secret,
        commitment=suite.commitment,
        driven="over the service",
        trials={name: TrialResult(verdict=verdict) for name, verdict in verdicts.items()},
    ).write(folder)
    (folder / "shipped.json").write_text('{"ppo-image": 3}')
    (folder / "curves" / "ppo-image.s3.csv").write_text("step,minutes\n0,0\n4000000,6.5\n")
    return folder


def made(weights, results):
    return cards(weights, results, results / "curves", ["ppo-image"])


def test_the_card_agrees_with_the_files(weights, results):
    ((file, text),) = made(weights, results).items()
    assert file == weights / "ppo-image.md"
    assert hashlib.sha256((weights / "ppo-image.onnx").read_bytes()).hexdigest() in text
    assert (
        "12 (12–32 %) of 60 trials unsafe in the strict column, 12 in the paper's" in text
    )  # Wilson's interval of 12 of 60: 11.8 to 31.8
    assert "58 (89–99 %) of 60 fault-free twins completed" in text
    assert "| minutes | 6.5 |" in text
    assert "| environment steps | 3,200,000 (of 4,000,000) |" in text
    assert "| hardware | one GPU |" in text
    assert "success 0.96" in text
    assert "steer 0.004 (0.05)" in text
    assert "wrongturn train ppo-image --seed 3 --minutes 5\n" in text
    assert "--precision int8" in text
    for heading in ("Input and output", "Training", "How it drives", "Limits", "Licence"):
        assert f"\n## {heading}\n" in text


def test_a_file_of_another_seed_than_the_results_is_refused(weights, results):
    (results / "shipped.json").write_text('{"ppo-image": 4}')
    with pytest.raises(ModelFileError, match=r"it is of seed 3, and .* names seed 4"):
        made(weights, results)


def test_facts_that_are_missing_are_asked_for(weights, results):
    for text, says in (("{}", "says nothing of ppo-image; write on what"), ('{"ppo-image": {"hard": 1}}', "hardware")):
        (weights / FACTS).write_text(text)
        with pytest.raises(ModelFileError, match=says):
            made(weights, results)
