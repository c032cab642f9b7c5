"""A method from another package, and a loop of one's own: what the docs show works."""

import re
import runpy
import sys
from pathlib import Path

import pytest
import torch
from typer.testing import CliRunner

from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.method import find_method, load, method_names
from wrongturn_agents.training.progress_file import read_rows
from wrongturn_client.cli import app

DOCS = Path(__file__).parents[3] / "docs"
SHORT = (
    "num_envs=4",
    "decisions=5",
    "traffic=0",
    "journeys=1",
    "brief_journeys=1",
    "patience=1",
    "evaluate_every=1000",
)


@pytest.fixture
def package(tmp_path, monkeypatch):
    """The page's example, installed."""
    section = (DOCS / "extending.md").read_text("utf-8").split("## A training method")[1].split("\n## ")[0]
    (source,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    (points,) = re.findall(r"```toml\n\[project\.entry-points\.\"(.*?)\"\]\n(.*?)```", section, re.DOTALL)
    (tmp_path / "hill_climbing.py").write_text(source)
    told = tmp_path / "hill_climbing-1.0.dist-info"
    told.mkdir()
    (told / "METADATA").write_text("Metadata-Version: 2.1\nName: hill-climbing\nVersion: 1.0\n")
    (told / "entry_points.txt").write_text(f"[{points[0]}]\n{points[1].replace(chr(34), '')}broken = gone:METHOD\n")
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    sys.modules.pop("hill_climbing", None)


def test_a_method_of_another_package_is_trained_resumed_and_exported(package):
    assert "hill-climbing" in method_names()
    folder, exported = package / "run", package / "hill.onnx"
    given = ["--directory", folder, "--threads", 1, "--device", "cpu"]
    options = [word for option in SHORT for word in ("--option", option)]
    for command in (
        ["train", "hill-climbing", *given, "--steps", 60, *options],
        ["train", "hill-climbing", *given, "--steps", 100, "--resume"],
        ["export", folder / "best.pt", exported],
    ):
        done = CliRunner().invoke(app, [str(word) for word in command])
        assert done.exit_code == 0, done.output or done.exception
    assert [int(row["step"]) for row in read_rows(folder / "progress.csv")] == [20, 40, 60, 60, 80, 100, 100]
    found = load(folder / "best.pt")
    assert (found.agent.name, found.agent.track, found.settings.decisions) == ("hill-climbing", "privileged", 5)
    assert found.told["evaluation"]["journeys"] == 1
    assert exported.stat().st_size > 0


def test_a_method_that_cannot_be_loaded_is_named(package):
    with pytest.raises(TrainingError, match=r"ALGORITHM: broken of hill-climbing \(gone:METHOD\) cannot be loaded"):
        find_method("broken")


def test_the_example_of_one_file_learns(tmp_path, monkeypatch, capsys):
    example, saved = DOCS / "examples" / "one_file_ppo.py", tmp_path / "agent.pt"
    assert len(example.read_text("utf-8").splitlines()) <= 200
    words = ("--steps", "512", "--num-envs", "8", "--rollout", "16", "--save", str(saved))
    monkeypatch.setattr(sys, "argv", [str(example), *words])
    runpy.run_path(str(example), run_name="__main__")
    assert "512 steps" in capsys.readouterr().out.splitlines()[-1]
    assert torch.load(saved, weights_only=True)["policy.0.weight"].isfinite().all()
