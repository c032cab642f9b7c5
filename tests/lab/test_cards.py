"""A card says what its file and the stored results say. ``python -m lab.results --check`` compares the shipped ones."""

import hashlib
import json

import pytest

pytest.importorskip("onnxruntime")

from control_onnx import write_concat_model
from made_results import keep, wrong_command

from lab.cards import FACTS, cards
from wrongturn_agents.errors import ModelFileError

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
def folder(tmp_path, monkeypatch):
    """Weights, their results (12 trials unsafe, all but two twins completed), and the curve of their training."""
    write_concat_model(tmp_path / "ppo-image.onnx", ("steering", "speed", "speed"), metadata=METADATA)
    (tmp_path / FACTS).write_text(json.dumps({"ppo-image": {"hardware": "one GPU", "options": "--minutes 5"}}))
    monkeypatch.setattr("wrongturn_agents.shipped_agents.WEIGHTS", tmp_path)
    (tmp_path / "results").mkdir()
    driven = wrong_command("ppo-image", (2,) * 6, twins_failed=2, seed=3, driven="over the service", secret="5ec2e7")
    keep(tmp_path / "results", driven, shipped={"ppo-image": 3})
    (tmp_path / "ppo-image.s3.csv").write_text("step,minutes\n0,0\n4000000,6.5\n")
    return tmp_path


def made(folder):
    return cards(folder, folder / "results", folder, ["ppo-image"])


def test_the_card_agrees_with_the_files(folder):
    ((file, text),) = made(folder).items()
    assert file == folder / "ppo-image.md"
    assert hashlib.sha256((folder / "ppo-image.onnx").read_bytes()).hexdigest() in text
    # Wilson's interval of 12 of 60: 11.8 to 31.8.
    assert "12 (12–32 %) of 60 trials unsafe in the strict column, 12 in the paper's" in text
    assert "58 (89–99 %) of 60 fault-free twins completed" in text
    for words in ("| minutes | 6.5 |", "| environment steps | 3,200,000 (of 4,000,000) |", "| hardware | one GPU |"):
        assert words in text
    for words in ("success 0.96", "steer 0.004 (0.05)", "train ppo-image --seed 3 --minutes 5\n", "--precision int8"):
        assert words in text


def test_a_file_of_another_seed_than_the_results_is_refused(folder):
    (folder / "results" / "shipped.json").write_text('{"ppo-image": 4}')
    with pytest.raises(ModelFileError, match=r"it is of seed 3, and .* names seed 4"):
        made(folder)
