"""An agent from pixels, from its file to the table."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from random_convolution import write_random_convolution

from wrongturn_agents.onnx_agent import OnnxAgent
from wrongturn_protocol import Track


def test_its_inputs_tell_its_track(tmp_path: Path) -> None:
    assert OnnxAgent(write_random_convolution(tmp_path / "pixels.onnx")).track is Track.CAMERA


@pytest.mark.soak  # CI drives a file so in the test of the tutorial, and pixels in tests/runner
@pytest.mark.system
def test_it_runs_over_http_to_the_table(tmp_path: Path) -> None:
    model = write_random_convolution(tmp_path / "pixels.onnx")
    record = tmp_path / "evaluation.json"
    command = [sys.executable, "-m", "wrongturn_client", "run", str(model), "--suite", "smoke@2", "--json", str(record)]
    done = subprocess.run(
        [*command, "--progress", "lines"],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
        env=_environment(tmp_path),
    )
    assert done.returncode == 0, done.stderr
    assert "LEFT_RIGHT" in done.stdout
    evaluation = json.loads(record.read_text())
    assert evaluation["state"] == "finished"
    assert evaluation["finished"] == evaluation["trials"] == 12
    assert sum(evaluation["metrics"]["verdicts"]["none"].values()) == 6


def _environment(home: Path) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("WRONGTURN_")}
    numba = os.environ.get("NUMBA_CACHE_DIR")
    # A home of its own keeps the user's database out of it; the compiled kernels are shared.
    return kept | {"WRONGTURN_HOME": str(home)} | ({"NUMBA_CACHE_DIR": numba} if numba else {})
