"""A training method that only counts, as a package for one test, and the programs that train by it."""

import os
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from wrongturn_client.cli import app

COUNTING = """
import time
from dataclasses import dataclass
from typing import ClassVar
from torch import nn
from wrongturn_agents.training import Method, Settings, TrainedAgent
from wrongturn_agents.training.errors import TrainingError
from wrongturn_protocol import Track

@dataclass(frozen=True, kw_only=True)
class CountingSettings(Settings):
    algorithm: ClassVar[str] = "counting"
    steps: int = 10
    bad: int = 99
    save_every: float = 10.0

class Counting(Method):
    settings = CountingSettings
    agents = (TrainedAgent("counting", Track.STATE, ("speed",), "Counts."),)

    def build(self, settings, algorithm):
        return nn.Linear(1, 1)

    def learn(self, run):
        count = run.state["count"] if run.state else 0
        run.open(count)
        if run.seed == run.settings.bad:
            raise TrainingError("option bad: is this seed")
        while not run.over(count):
            time.sleep(0.01)
            count += 1
            run.row(count)
            if count == 1 or run.save_due:
                run.save_state(count=count)
        run.save("best.pt", self.build(run.settings, ""), count)
        run.save_state(count=count)

METHOD = Counting()
"""


@pytest.fixture
def counting(tmp_path, monkeypatch):
    """Install the method, in an empty directory."""
    (tmp_path / "counting.py").write_text(COUNTING)
    info = tmp_path / "counting-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: counting\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[wrongturn.methods]\ncounting = counting:METHOD\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.chdir(tmp_path)


def trained(*words):
    return CliRunner().invoke(app, ["train", *map(str, words)])


def until(condition, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it took too long"
        time.sleep(0.05)


def program_of(name):
    """The number of the process that trains in a directory."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if f"--directory={Path('runs', name).absolute()}".encode() in words:
            return int(folder.name)
    raise AssertionError(f"nobody trains {name}")
