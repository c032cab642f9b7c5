"""A training loop of one's own: the example in docs/training.md learns."""

import runpy
import sys
from pathlib import Path

import torch

EXAMPLE = Path(__file__).parents[3] / "docs" / "examples" / "one_file_ppo.py"


def test_the_example_of_one_file_learns(tmp_path, monkeypatch, capsys):
    saved = tmp_path / "agent.pt"
    assert len(EXAMPLE.read_text("utf-8").splitlines()) <= 200
    words = ("--steps", "512", "--num-envs", "8", "--rollout", "16", "--save", str(saved))
    monkeypatch.setattr(sys, "argv", [str(EXAMPLE), *words])
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    assert "512 steps" in capsys.readouterr().out.splitlines()[-1]
    assert torch.load(saved, weights_only=True)["policy.0.weight"].isfinite().all()
