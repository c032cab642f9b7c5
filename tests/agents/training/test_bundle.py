import json

import pytest
import torch

from wrongturn_agents.models import build
from wrongturn_agents.training import bundle
from wrongturn_agents.training.bundle import join, split
from wrongturn_agents.training.checkpoint import load_checkpoint, model_of, save_checkpoint
from wrongturn_agents.training.config import config_of
from wrongturn_agents.training.errors import TrainingError


def checkpoint(path, algorithm="ppo-segmentation", seed=5):
    save_checkpoint(
        path, build(algorithm, seed=seed), config_of(algorithm), seed=seed, steps=24, evaluation={"success": 0.5}
    )
    return path


def test_what_is_joined_drives_as_what_was_split(tmp_path, monkeypatch):
    monkeypatch.setattr(bundle, "PART", 1_000_000)
    whole = checkpoint(tmp_path / "best.pt")
    manifest = split(whole, tmp_path / "bundle", "ppo-segmentation")
    parts = sorted((tmp_path / "bundle").glob("*.part"))
    assert len(parts) == 7
    assert max(part.stat().st_size for part in parts) == 1_000_000
    join(manifest, tmp_path / "again.pt")
    before, after = load_checkpoint(whole), load_checkpoint(tmp_path / "again.pt")
    assert {key: before[key] for key in ("seed", "steps", "config", "evaluation")} == {
        key: after[key] for key in ("seed", "steps", "config", "evaluation")
    }
    observation = {
        "speed": torch.rand(4, 1),
        "steering": torch.zeros(4, 1),
        "command": torch.tensor([[1], [2], [3], [4]]),
        "segmentation": torch.randint(0, 11, (4, 64, 192), dtype=torch.uint8),
    }
    with torch.inference_mode():
        one, other = (model_of(found).drive(observation) for found in (before, after))
    torch.testing.assert_close(one, other, atol=2e-3, rtol=0)


def test_a_better_one_takes_its_place(tmp_path):
    split(checkpoint(tmp_path / "a.pt"), tmp_path, "x")
    manifest = split(checkpoint(tmp_path / "b.pt", seed=6), tmp_path, "x")
    told = json.loads(manifest.read_text())
    assert told["seed"] == 6
    assert {part["file"] for part in told["parts"]} == {path.name for path in tmp_path.glob("*.part")}


def test_a_broken_part_is_refused(tmp_path):
    manifest = split(checkpoint(tmp_path / "a.pt"), tmp_path, "x")
    part = next(tmp_path.glob("*.part"))
    part.write_bytes(part.read_bytes()[:-1] + b"?")
    with pytest.raises(TrainingError, match="broken"):
        join(manifest, tmp_path / "b.pt")
    part.unlink()
    with pytest.raises(TrainingError, match="missing"):
        join(manifest, tmp_path / "b.pt")


@pytest.mark.slow
def test_what_only_learning_needs_is_left_out(tmp_path):
    manifest = split(checkpoint(tmp_path / "a.pt", "ppo-auxiliary"), tmp_path, "x")
    assert json.loads(manifest.read_text())["bytes"] < 55_000_000
    join(manifest, tmp_path / "b.pt")
    assert model_of(load_checkpoint(tmp_path / "b.pt")).algorithm == "ppo-auxiliary"
    found = torch.load(tmp_path / "b.pt", weights_only=True)
    del found["state_dict"]["log_std"]
    with pytest.raises(TrainingError, match="log_std"):
        model_of(found)
