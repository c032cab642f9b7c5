"""The file of a run: what is no such file is told with its remedy."""

import gzip
import json
from pathlib import Path

import pytest

from wrongturn_protocol import RunFile, RunFormatError, Verdict, run_file

COUNT = {"count": 0, "trials": 1, "rate": 0.0, "ci95": [0.0, 1.0]}
CONTENT = {
    "id": "ev_1",
    "suite": "smoke@3",
    "agent": "ag_1",
    "state": "finished",
    "trials": 1,
    "finished": 1,
    "max_parallel": 1,
    "metrics": {
        "unsafe": COUNT,
        "unsafe_strict": COUNT,
        "twins": {"unsafe": 0, "completed": 0, "trials": 1},
        "excess_unsafe_rate": None,
        "table": {},
        "reactions": {},
        "verdicts": {},
    },
    "suite_sha256": "0" * 64,
    "driver": {"id": "ag_1", "name": "by hand", "track": "camera", "kind": "submitted"},
    "episodes": [
        {"id": "ep_1", "trial": "a", "outcome": {"verdict": "off_road", "time": 1.0, "max_deceleration": 0.0}}
    ],
}


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_a_file_is_read_plain_or_compressed(tmp_path: Path, pack) -> None:
    path = tmp_path / "any name"
    path.write_bytes(pack(json.dumps(CONTENT).encode()))
    file = RunFile.read(path)
    assert file.driver.name == "by hand"
    assert file.by_trial()["a"].outcome.verdict is Verdict.OFF_ROAD


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"state": "running"}, r"run\.json: state: .*'finished'.*write it with 'wrongturn run --json FILE'"),
        ({"episodes": None}, r"run\.json: episodes: "),
        ({"suite_sha256": "x"}, r"run\.json: suite_sha256: "),
        ({"metrics": None}, r"run\.json: metrics: "),
        ({"more": 1}, r"run\.json: more: "),
    ],
)
def test_a_wrong_field_is_named(tmp_path: Path, change, says) -> None:
    path = tmp_path / "run.json"
    path.write_text(json.dumps({**CONTENT, **change}))
    with pytest.raises(RunFormatError, match=says):
        RunFile.read(path)


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_a_file_that_is_cut_off_is_told(tmp_path: Path, pack) -> None:
    whole = pack(json.dumps(CONTENT).encode())
    path = tmp_path / "run.json"
    for kept in (0, 1, 2, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:kept])
        with pytest.raises(RunFormatError, match=r"run\.json: .*again with 'wrongturn run --resume ID --json FILE'"):
            RunFile.read(path)


@pytest.mark.parametrize("pack", [bytes, gzip.compress])
def test_a_file_that_is_too_large_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pack) -> None:
    monkeypatch.setattr(run_file, "LARGEST", 1 << 20)
    path = tmp_path / "run.json"
    content = json.dumps(CONTENT).encode()
    path.write_bytes(pack(content.ljust(1 << 20)))
    assert RunFile.read(path).driver.name == "by hand"
    path.write_bytes(pack(content.ljust((1 << 20) + 1)))
    with pytest.raises(RunFormatError, match=r"run\.json: cannot be read \(unpacked it has more than 1 MiB\)"):
        RunFile.read(path)


def test_a_file_that_is_missing_is_told(tmp_path: Path) -> None:
    with pytest.raises(RunFormatError, match=r"cannot be read \(No such file or directory\)"):
        RunFile.read(tmp_path / "none.json")
