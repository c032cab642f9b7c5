"""What the page on models shows is true: its programs make models that drive."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("onnxruntime")

from wrongturn_agents import resolve
from wrongturn_protocol import Track
from wrongturn_protocol.observations import observation_space
from wrongturn_sandbox.checking import check

PAGE = (Path(__file__).parents[2] / "docs/models.md").read_text("utf-8")
PROGRAMS: dict[str, str] = dict(re.findall(r'```python title="(\w+\.py)"\n(.*?)```', PAGE, re.DOTALL))


def drive(file: Path, steps: int = 5) -> list[tuple[float, float, float]]:
    """Return a model's actions on the same observation, after what a service checks before it loads a file."""
    check(file.read_bytes())
    agent = resolve(str(file)).make()
    assert agent.track is Track.CAMERA
    space = observation_space(Track.CAMERA)
    space.seed(3)
    observation = space.sample()
    agent.reset(space)
    actions = [agent.act(observation) for _ in range(steps)]
    return [(action.steer, action.throttle, action.brake) for action in actions]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Run the page's programs, one after the other in one process, and return the folder of their models."""
    folder = tmp_path_factory.mktemp("programs")
    for name, text in PROGRAMS.items():
        (folder / name).write_text(text, "utf-8")
    each = f"import runpy\nfor name in {list(PROGRAMS)}: runpy.run_path(name, run_name='__main__')"
    done = subprocess.run([sys.executable, "-c", each], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def test_the_programs_write_their_models_and_nothing_else(folder):
    models = {name.replace(".py", ".onnx") for name in PROGRAMS}
    assert {path.name for path in folder.iterdir()} == {*PROGRAMS, *models}


def test_plain_torch_makes_a_model_in_fifteen_lines(folder):
    assert len([line for line in PROGRAMS["my_driver.py"].splitlines() if line.strip()]) <= 15
    actions = drive(folder / "my_driver.onnx")
    assert len(set(actions)) == 1
    assert actions[0] != (0.0, 0.0, 0.0)


def test_a_recurrent_model_remembers(folder):
    file = folder / "my_rememberer.onnx"
    first = drive(file)
    assert len(set(first)) == len(first)
    assert drive(file) == first
