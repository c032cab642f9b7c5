"""The demo, narrowed down, and what the commands of the laboratory refuse."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from lab import demo, held_out
from wrongturn_agents.shipped_agents import WEIGHTS


def run_demo(folder, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "lab.demo", *arguments]
    env = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, timeout=600, check=False)


def test_a_worker_that_fails_is_told_with_its_last_words():
    failed = demo.drive_all(["careful"], ["--url", "http://127.0.0.1:9", "--suite", "smoke@3"], os.environ)
    assert "no Wrongturn service answers at http://127.0.0.1:9" in failed["careful"][-1]


def test_two_demos_do_not_share_a_folder(tmp_path):
    with demo._folder(tmp_path / "demo"):
        second = run_demo(tmp_path, "--agents", "parked", "--suite", "smoke@3")
    assert second.returncode == 1
    assert "another demo is running there" in second.stderr


@pytest.mark.parametrize(
    ("main", "arguments", "says"),
    [
        (demo.main, ["--agents", "careful,nobody"], "--agents: there is no agent called 'nobody'; known are parked"),
        (demo.main, ["--agents", ","], "--agents: names no agent"),
        (demo.main, ["--agents", "careful,careful"], "names an agent twice"),
        (demo.main, ["--suite", "nothing@1"], "--suite: 'nothing@1' is not known; there are: disturbed@1, "),
        (held_out.main, ["nothing.onnx", "--journeys", "0"], "--journeys: is 0; give 1 or more"),
        (held_out.main, ["nothing.onnx", "--cameras", "--after", "3"], "--after: is 3; give a multiple of 5"),
        (held_out.main, [str(WEIGHTS / "lbc.onnx")], "lbc.onnx: has a memory, a rig or another track than camera"),
        (held_out.main, [str(WEIGHTS / f"ppo-{x}.onnx") for x in ("image", "segmentation")], "are of both tracks"),
    ],
)
def test_mistakes_are_told_before_anything_starts(tmp_path, monkeypatch, capsys, main, arguments, says):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="2"):
        main(arguments)
    assert says in capsys.readouterr().err
    assert not (tmp_path / "demo").exists()
