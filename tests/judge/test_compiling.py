import os
import subprocess
import sys

CALLEE = "from numba import njit\n\n@njit(cache=True)\ndef number():\n    return {}\n"
CALLER = """
import callee
from wrongturn_judge.compiling import compiled_with

@compiled_with(callee)
def twice():
    return 2 * callee.number()

print(twice())
"""


def test_a_change_of_what_is_called_is_noticed(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER, encoding="utf-8")
    found = []
    for number in (1, 1, 3):
        (tmp_path / "callee.py").write_text(CALLEE.format(number), encoding="utf-8")
        done = subprocess.run(
            [sys.executable, "-c", "import caller"],
            cwd=tmp_path,
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONDONTWRITEBYTECODE": "1"},
            capture_output=True,
            text=True,
            check=True,
        )
        found.append(done.stdout.strip())
    assert found == ["2", "2", "6"]
    assert len(list((tmp_path / "cache").rglob("*twice*.nbi"))) == 2


def test_the_first_compilation_of_a_machine_is_announced_once(tmp_path):
    code = "from wrongturn_sim.ego import advance; advance(*[0.0] * 8, 0.05)"
    said = []
    for _ in range(2):
        for file in tmp_path.rglob("*.nb?"):
            file.unlink()
        done = subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        said.append(done.stderr.count("wrongturn: compiling"))
    assert said == [1, 0]
