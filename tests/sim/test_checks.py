import os
import stat
import subprocess
import sys

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


def test_compiled_kernels_are_kept_under_wrongturn_home(tmp_path):
    code = (
        "import os; from wrongturn_sim.ego import advance; advance(*[0.0] * 8, 0.05);"
        "print(os.environ['NUMBA_CACHE_DIR'])"
    )
    assert run(code, WRONGTURN_HOME=str(tmp_path)) == str(tmp_path / "numba")
    assert any(tmp_path.rglob("*.nbc"))


def test_a_users_own_cache_directory_is_kept(tmp_path):
    code = "import wrongturn_sim, os; print(os.environ['NUMBA_CACHE_DIR'])"
    assert run(code, WRONGTURN_HOME=str(tmp_path), NUMBA_CACHE_DIR=str(tmp_path / "own")) == str(tmp_path / "own")


def test_a_home_that_cannot_be_made_is_no_obstacle(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("", encoding="ascii")
    blocked.chmod(stat.S_IRUSR)
    code = "from wrongturn_sim.ego import advance; print(advance(*[0.0] * 8, 0.05)[3])"
    assert run(code, WRONGTURN_HOME=str(blocked / "home")) == "0.0"
