import json
import os
import stat

import pytest

from wrongturn_agents.errors import RunFileError
from wrongturn_agents.saved_run import RunDatabase, SavedRun, directory


@pytest.fixture
def saved_run(tmp_path, monkeypatch) -> SavedRun:
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "home"))
    return SavedRun(agent="careful", name="careful", suite="smoke@3", evaluation="ev-1", token="secret", url=None)


def test_only_its_owner_may_read_it(saved_run):
    path = saved_run.save()
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700


def test_it_is_found_by_id_and_by_file(saved_run):
    path = saved_run.save()
    assert SavedRun.load("ev-1") == saved_run
    assert SavedRun.load(str(path)) == saved_run


def test_an_unknown_one_lists_the_known(saved_run):
    saved_run.save()
    with pytest.raises(RunFileError, match=r"no run 'ev-2'.*runs known here: ev-1"):
        SavedRun.load("ev-2")


@pytest.mark.parametrize("text", ["", "[]", json.dumps({"agent": "careful"}), "\x00"])
def test_another_file(saved_run, tmp_path, text):
    file = tmp_path / "other.json"
    file.write_text(text)
    with pytest.raises(RunFileError, match="is not a saved run"):
        SavedRun.load(str(file))


def test_a_home_that_cannot_be_written(saved_run, tmp_path, monkeypatch):
    (tmp_path / "plain").write_text("")
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "plain"))
    with pytest.raises(RunFileError, match="let WRONGTURN_HOME name a writable directory"):
        saved_run.save()


def test_a_new_database_removes_those_that_nobody_needs(saved_run):
    with RunDatabase() as interrupted:
        interrupted.needed = True
        saved_run.model_copy(update={"database": interrupted.folder}).save()
    left, going_on = (directory() / f"database-{name}" for name in ("left", "going-on"))
    for folder in (left, going_on):
        folder.mkdir()
    os.utime(left, (0.0, 0.0))
    with RunDatabase() as passing:
        assert passing.folder.exists()
    assert set(directory().glob("database-*")) == {interrupted.folder, going_on}
