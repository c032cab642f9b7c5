"""Drives of other simulators: what is judged as it was driven, what is refused and how, and what the command says."""

import functools
import json
import math
import re
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from lab.films import drive_trial
from lab.recordings import AGENTS, recording_of, to_csv, trials
from wrongturn_client import cli
from wrongturn_judge.errors import RecordingError
from wrongturn_judge.recording_file import judge_file
from wrongturn_judge.recordings import judged
from wrongturn_networks import NetworkError, draw_trial, load_town
from wrongturn_protocol import Outcome, Recording
from wrongturn_protocol.json_output import with_stdout

COLUMNS = ("t", "x", "y", "yaw", "speed")


@functools.cache
def driven(fault: str = "infeasible") -> tuple[Recording, Outcome]:
    """What a driver that obeys blindly does at a T-junction of Town01, and its outcome."""
    found = drive_trial("obeys-blindly", draw_trial(load_town("Town01"), "J3-S", fault, 17))
    assert found.outcome is not None
    return recording_of(found.trajectory), found.outcome


def changed(recording: Recording, **fields: Any) -> Recording:
    return Recording.model_validate({**recording.model_dump(), **fields})


def test_native_drives_get_their_outcomes_back(tmp_path: Path) -> None:
    for number, trial in islice(enumerate(trials()), 0, None, 7):
        native = drive_trial(AGENTS[number % len(AGENTS)], trial)
        recording = recording_of(native.trajectory)
        file = tmp_path / "drive"
        file.write_text(to_csv(recording) if not recording.others else recording.model_dump_json())
        outcome = judge_file(file)[0].outcome
        assert native.outcome is not None
        for name, value in native.outcome:
            assert getattr(outcome, name) == (pytest.approx(value) if "ttc" in name and value else value), trial.id
        for thinned in (recording_of(native.trajectory, 2), recording_of(native.trajectory, 4)):
            assert judged(thinned)[0].verdict is native.outcome.verdict, trial.id


@pytest.mark.parametrize("frame", ["town", "carla"])
@pytest.mark.parametrize("units", ["m s rad km/h", "m s deg m/s"])
@pytest.mark.parametrize(("reference", "ahead"), [("centre", 0.0), ("rear_axle", -1.45), ("front_bumper", 2.3)])
def test_frames_units_and_reference_points_change_nothing(frame: str, units: str, reference: str, ahead: float) -> None:
    recording, outcome = driven()
    x, y, yaw, v = (np.array(getattr(recording, name)) for name in ("x", "y", "yaw", "speed"))
    x, y, turn = x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), 1 if frame == "town" else -1
    columns = {"x": x, "y": turn * y, "yaw": turn * (np.degrees(yaw) if "deg" in units else yaw)}
    columns |= {"t": np.array(recording.t) + 1.7e9, "speed": v * 3.6 if "km/h" in units else v}
    head = {"frame": frame, "units": units, "reference": reference, "rear_axle": 1.45}
    found = judged(changed(recording, **head, **{name: tuple(column.tolist()) for name, column in columns.items()}))[0]
    assert found.outcome is not None
    assert (found.verdict, found.outcome.reaction) == (outcome.verdict, outcome.reaction) == ("off_road", "obeyed")
    assert (found.unsafe, found.severity_mps) == (True, pytest.approx(outcome.speed_at_verdict))
    assert found.outcome.time == pytest.approx(outcome.time, abs=0.051)  # the clock's digits end at 2e-7 s


@pytest.mark.parametrize("gap", [0.01, 0.0333, 0.07, 0.19])
def test_any_rate_from_5_to_100_hz_gives_the_verdict(gap: float) -> None:
    recording, outcome = driven("none")
    t = np.append(np.arange(0, recording.t[-1] - 0.01, gap), recording.t[-1])
    lists = {name: tuple(np.interp(t, recording.t, getattr(recording, name)).tolist()) for name in COLUMNS}
    told = tuple((recording.commands or ())[k] for k in np.searchsorted(recording.t, t, side="right") - 1)
    assert judged(changed(recording, **lists, commands=told))[0].verdict is outcome.verdict


def test_the_command_may_stand_in_the_header_with_its_time() -> None:
    recording, outcome = driven()
    said = next(k for k, one in enumerate(recording.commands or ()) if one != "LANE_FOLLOW")
    head = {"commands": None, "command": (recording.commands or ())[said], "route": None}
    found, trajectory = judged(changed(recording, **head, command_at=recording.t[said], others=None))
    assert found.outcome is not None
    assert found.outcome.reaction is outcome.reaction
    assert [row.command for row in trajectory.rows].count(4) == said + 1
    assert [note.split(",")[0] for note in found.notes] == [
        "The route was not given",
        "Collisions with other road users were not judged",
    ]


def test_other_road_users_and_the_size_of_the_car_count() -> None:
    recording, _ = driven("none")
    there = len(recording.t) // 2
    still = {"length": 4.5, "width": 1.8, **{name: [getattr(recording, name)[there]] for name in ("x", "y", "yaw")}}
    user = {**still, **{name: still[name] * len(recording.t) for name in ("x", "y", "yaw")}}
    hit = judged(changed(recording, others=({**user, "speed": [0.0] * len(recording.t)},)))[0]
    away = {name: [None] * len(recording.t) for name in ("x", "y", "yaw", "speed")}
    missed = judged(changed(recording, others=({**user, **away},)))[0]
    assert (hit.verdict, missed.verdict) == ("collision", "exit_commanded")
    bites = [judged(changed(driven()[0], width=width, length=5.0))[0].outcome for width in (1.0, 2.1)]
    assert bites[0] is not None
    assert bites[1] is not None
    assert (bites[0].kerb_bite_m or 0.0) < (bites[1].kerb_bite_m or 0.0)


@pytest.mark.parametrize(("rows", "most"), [(30, 60.0), (-2, 2.1)])
def test_a_drive_that_ends_too_early_is_undecided(rows: int, most: float) -> None:
    recording, outcome = driven("none")
    short = {name: getattr(recording, name)[:rows] for name in ("t", "x", "y", "yaw", "speed", "commands")}
    found = judged(changed(recording, **short))[0]
    assert (found.verdict, found.outcome) == (None, None)
    assert outcome.time - short["t"][-1] == pytest.approx(found.seconds_more, abs=1e-6) or rows > 0
    assert found.seconds_more is not None
    assert 0 < found.seconds_more <= most
    assert f"Undecided: {found.seconds_more:.2f} s more" in found.notes[-1]
    still = {name: (getattr(recording, name)[0],) * 41 for name in ("x", "y", "yaw", "commands")}
    stands = changed(recording, **still, t=tuple(k / 10 for k in range(41)), speed=(0.0,) * 41)
    assert judged(stands)[0].seconds_more == pytest.approx(6.0)


BROKEN = {
    "empty": ("", "", "file: is empty"),
    "binary": ("# town", "\udcff\udcfe\x00", "file: cannot be read (it is no text)"),
    "no town": ("# town: Town01\n", "", "town: missing; give a town's name"),
    "unknown town": ("Town01", "Town99", "town: 'Town99' is not known; there are"),
    "unknown approach": ("J3-S", "J3-X", "approach: 'J3-X' is not known; there are"),
    "other approach": ("J3-S", "J5-E", "line 2: approach: the car is never on its lane, and begins 0 m from the road"),
    "far from the road": ("frame: town", "frame: carla", "m from the road, nearest to the lane of"),
    "no frame": ("frame: town", "frame: utm", "line 3: frame: is 'utm'; give town (x east"),
    "wrong units": ("m s rad m/s", "ft s rad mph", "line 4: units: is 'ft s rad mph'; give units of length"),
    "km/h as m/s": ("units: m s rad m/s", "units: m s rad km/h", "line 12: speed: adds up to"),
    "rear axle": ("reference: centre", "reference: rear_axle", "rear_axle: missing; give metres from it"),
    "a truck": ("length: 4.6", "length: 12", "line 6: length: is '12'; give the car's length, 2 to 5.6 m"),
    "unknown entry": ("# watch", "# watc: 3\n# watch", "watc: is unknown; leave it out. Did you mean watch?"),
    "no entry": ("# width: 1.9", "# width 1.9", "line 7: is no new header entry; write '# name: value' once"),
    "told twice": ("# width", "# frame: town\n# width", "line 7: is no new header entry"),
    "two columns": ("t,x,y", "t,x,x", "names a column that is there already; keep one"),
    "a missing cell": ("\n0.1,", "\n", "line 15: has 5 cells; give one for each of 6 columns"),
    "no number": ("\n0.1,", "\nsoon,", "line 15: t: is 'soon'; give finite numbers in the units"),
    "nan": ("\n0.1,", "\nnan,", "line 15: t: is 'nan'; give finite numbers in the units"),
    "infinite": ("\n0.1,", "\ninf,", "line 15: t: is 'inf'; give finite numbers in the units"),
    "back in time": ("\n0.1,", "\n0.04,", "line 15: t: is not after the row before; sort the rows"),
    "too dense": ("\n0.1,", "\n0.051,", "line 15: t: is less than 0.01 s after the row before; thin the rows"),
    "a gap": ("\n4.85,", "\n5.1,", "line 110: t: is more than 0.2 s after the row before; give 5 rows a second"),
    "a teleport": ("\n0.1,", "\n0.1,1", "line 15: x: jumps, with y, as no car does; check units, or cut"),
    "unknown command": ("LANE_FOLLOW\n0.1,", "UTURN\n0.1,", "line 14: commands: is 'UTURN'; give in place of command"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_told_by_line_and_remedy(name: str, tmp_path: Path) -> None:
    old, new, said = BROKEN[name]
    whole = to_csv(driven()[0])
    text = whole.replace(old, new, 1) if old else ""
    assert text != whole
    file = tmp_path / "drive.csv"
    file.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises((RecordingError, NetworkError), match=re.escape(said)):
        judge_file(file)


def test_json_is_refused_by_field_and_index(tmp_path: Path) -> None:
    file, whole = tmp_path / "drive.json", json.loads(driven()[0].model_dump_json())
    users = {"length": 4.5, "width": 1.8, **{name: [0.0] * 9 for name in ("x", "y", "yaw", "speed")}}
    for fields, said in (
        ({"x": [math.nan, *whole["x"][1:]]}, "x.0: is nan; give finite numbers in the units"),
        ({"y": whole["y"][1:]}, "y: is not as long as t; give"),
        ({"others": [users]}, "others.0.x: is not as long as t; give"),
        ({"command": "LEFT"}, "command: give either command in the header or"),
        ({"fault": "substitution", "route": "RIGHT"}, "cannot name"),
        ({"route": "LEFT"}, "route: Town01 J3-S has no exit LEFT; it has"),
        ("{1", "file: is not JSON (key must be a string"),
        ("{" * (5 << 20), "larger than 4 MiB"),
    ):
        file.write_text(fields if isinstance(fields, str) else json.dumps({**whole, **fields}))
        with pytest.raises((RecordingError, NetworkError), match=re.escape(said)):
            judge_file(file)


def test_the_command_judges_draws_and_fails_where_a_file_is_wrong(tmp_path: Path) -> None:
    drive, wrong = tmp_path / "drive.csv", tmp_path / "wrong.csv"
    drive.write_text(to_csv(driven()[0]))
    wrong.write_text("t,x\n")
    pictures = tmp_path / "pictures"
    done = CliRunner().invoke(cli.app, ["judge", str(drive), str(wrong), "--picture", str(pictures)])
    assert done.exit_code == 1
    assert f"{drive}: off_road\n  unsafe: True" in done.stdout
    assert f"{wrong}: town: missing" in done.stderr
    assert (pictures / "drive.csv.png").read_bytes().startswith(b"\x89PNG")
    told = json.loads(CliRunner().invoke(cli.app, with_stdout(["judge", str(drive), "--json"])).stdout)
    assert (told[0]["verdict"], told[0]["notes"]) == ("off_road", [])


def test_the_page_shows_a_file_and_what_the_command_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[2] / "docs/judge.md").read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    Path("drive.csv").write_text(page.split('```csv title="drive.csv"\n')[1].split("```")[0])
    assert CliRunner().invoke(cli.app, ["judge", "drive.csv"]).stdout == page.split("```text\n")[1].split("```")[0]
