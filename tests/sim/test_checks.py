import os
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from wrongturn_sim import simulator as bridge
from wrongturn_sim.checks import checks
from wrongturn_sim.errors import SimulatorUnavailableError


def test_all_is_well_here():
    found = list(checks())
    assert [name for name, *_ in found] == ["libsumo", "kernel cache", "kernels", "episode"]
    assert all(ok for _, ok, *_ in found), found


def test_what_is_missing_is_told_with_its_remedy(monkeypatch):
    def fail():
        raise SimulatorUnavailableError("libXext.so.6 is missing")

    monkeypatch.setattr(bridge, "load_libsumo", fail)
    name, ok, detail, remedy = next(iter(checks()))
    assert (name, ok) == ("libsumo", False)
    assert "libXext" in detail
    assert remedy


def run(code, **environment):
    kept = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=kept | environment, capture_output=True, text=True, check=True, timeout=120
    )
    return done.stdout.strip()


KERNELS = "from wrongturn_sim.ego import advance; advance(*[0.0] * 8, 0.05);"
WHERE = "import os, wrongturn_sim; print(os.environ['NUMBA_CACHE_DIR'])"


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """Kernels that a run left under its WRONGTURN_HOME."""
    home = tmp_path_factory.mktemp("home")
    assert run(KERNELS + WHERE, WRONGTURN_HOME=str(home)) == str(home / "numba")
    assert any(home.rglob("*.nbc"))
    return home / "numba"


def test_a_users_own_cache_directory_is_kept(tmp_path):
    assert run(WHERE, WRONGTURN_HOME=str(tmp_path), NUMBA_CACHE_DIR=str(tmp_path / "own")) == str(tmp_path / "own")


def test_a_home_that_cannot_be_made_is_no_obstacle(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="ascii")
    blocked.chmod(stat.S_IRUSR)
    code = "from wrongturn_sim.ego import advance; print(advance(*[0.0] * 8, 0.05)[3])"
    assert run(code, WRONGTURN_HOME=str(blocked / "home")) == "0.0"


def test_kernels_that_came_along_are_copied_and_not_compiled_again(compiled, tmp_path):
    came, home = files(compiled), tmp_path / "home"
    (home / "numba" / "of an older version").mkdir(parents=True)
    (home / "numba-0123").mkdir()
    here = {"WRONGTURN_HOME": str(home), "WRONGTURN_KERNELS": str(compiled)}
    copy = Path(run(KERNELS + WHERE, **here))
    assert list(home.iterdir()) == [copy]
    assert files(copy) == came == files(compiled)
    # What another processor needs is added to the copy, and kept there.
    assert run(KERNELS + WHERE, **here, NUMBA_CPU_NAME="generic") == str(copy)
    assert came.keys() < files(copy).keys()
    assert files(compiled) == came
    assert run(WHERE, **here) == str(copy)
    assert came.keys() < files(copy).keys()


def test_kernels_of_another_image_have_a_copy_of_their_own(tmp_path):
    compiled, home = tmp_path / "compiled", tmp_path / "home"
    compiled.mkdir()
    copies = []
    for content in ("one", "another"):
        (compiled / "kernel").write_text(content, encoding="ascii")
        copies.append(run(WHERE, WRONGTURN_HOME=str(home), WRONGTURN_KERNELS=str(compiled)))
    assert copies[0] != copies[1]
    assert (Path(copies[1]) / "kernel").read_text(encoding="ascii") == "another"


def files(directory):
    return {file.relative_to(directory): file.read_bytes() for file in directory.rglob("*") if file.is_file()}
