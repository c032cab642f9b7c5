import json
import stat

import pytest

from wrongturn_agents.errors import RunFileError
from wrongturn_agents.run_file import RunFile


@pytest.fixture
def run_file(tmp_path, monkeypatch) -> RunFile:
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "home"))
    return RunFile(agent="careful", name="careful", suite="smoke@1", evaluation="ev-1", token="secret", url=None)


def test_only_its_owner_may_read_it(run_file):
    path = run_file.save()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_it_is_found_by_id_and_by_file(run_file):
    path = run_file.save()
    assert RunFile.load("ev-1") == run_file
    assert RunFile.load(str(path)) == run_file


def test_an_unknown_one_lists_the_known(run_file):
    run_file.save()
    with pytest.raises(RunFileError, match=r"no run 'ev-2'.*runs known here: ev-1"):
        RunFile.load("ev-2")


@pytest.mark.parametrize("text", ["", "[]", json.dumps({"agent": "careful"}), "\x00"])
def test_another_file(run_file, tmp_path, text):
    file = tmp_path / "other.json"
    file.write_text(text)
    with pytest.raises(RunFileError, match="is no run's file"):
        RunFile.load(str(file))


def test_a_home_that_cannot_be_written(run_file, tmp_path, monkeypatch):
    (tmp_path / "plain").write_text("")
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "plain"))
    with pytest.raises(RunFileError, match="let WRONGTURN_HOME name a writable directory"):
        run_file.save()
