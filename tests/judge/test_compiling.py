import os
import subprocess
import sys
from pathlib import Path

import pytest

import wrongturn_judge
import wrongturn_sim

FOLDERS = [Path(package.__file__).parent for package in (wrongturn_judge, wrongturn_sim)]
FILES = {
    "__init__": "",
    "numbers": "NUMBER = {}\n",
    "callee": "from made_up.numbers import (\n    NUMBER,\n)\n",
    "caller": """
from made_up import callee
from wrongturn_judge.compiling import compiled

@compiled()
def twice():
    return 2 * callee.NUMBER

print(twice())
""",
}


def run(code, **environment):
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"} | environment,
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip(), done.stderr


def test_a_change_of_what_is_imported_by_what_is_called_is_noticed(tmp_path):
    (tmp_path / "made_up").mkdir()
    found = []
    for number in (1, 3):
        for name, text in FILES.items():
            (tmp_path / "made_up" / f"{name}.py").write_text(text.replace("{}", str(number)), encoding="utf-8")
        cache = str(tmp_path / "cache")
        found.append(run("import made_up.caller", PYTHONPATH=str(tmp_path), NUMBA_CACHE_DIR=cache)[0])
    assert found == ["2", "6"]
    assert len(list((tmp_path / "cache").rglob("*twice*.nbi"))) == 2


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_all_code_that_is_kept_on_the_disk_is_compiled_so(folder):
    texts = {path.name: path.read_text(encoding="utf-8") for path in folder.rglob("*.py")}
    assert [name for name, text in texts.items() if "cache=True" in text and name != "compiling.py"] == []
    assert any("@compiled(" in text for text in texts.values())


def test_the_first_compilation_of_a_machine_is_announced_once(tmp_path):
    said = []
    for _ in range(2):
        for file in tmp_path.rglob("*.nb?"):
            file.unlink()
        _, told = run("from wrongturn_sim.ego import advance; advance(*[0.0] * 8, 0.05)", NUMBA_CACHE_DIR=str(tmp_path))
        said.append(told.count("wrongturn: compiling"))
    assert said == [1, 0]
