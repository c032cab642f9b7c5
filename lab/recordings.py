"""Native drives as recordings: export them, and count the verdicts that stay the same when they are judged again.

``python -m lab.recordings`` drives 100 trials and prints the table of ``docs/judge.md``; ``python -m lab.recordings
--export DIR FILE...`` writes native trajectories, or the episodes of files of ``run --json``, as CSV into DIR.
"""

import csv
import io
import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from lab.films import drive_trial
from wrongturn_judge import JudgeGeometry, judge
from wrongturn_judge.recordings import judged
from wrongturn_judge.trajectory import RoadUser, Trajectory
from wrongturn_networks import draw_trial, load_suite, load_town, town_of
from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults import available_faults, check_fault, fault_class, faults_at
from wrongturn_protocol import VEHICLE, Command, RecordedUser, Recording, Traffic, Trial
from wrongturn_protocol.run_file import RunFile, read_unpacked

COUNT: Final = 100
AGENTS: Final = (
    *("careful", "obeys-blindly", "ignores-commands", "always-stops", "late-obey", "maniac", "blocker"),
    *("circles", "head-on", "askew", "creeper", "broadside", "oncoming-lane"),
)
"""Drivers to every sort of verdict: the baselines, and exploits that only drive."""


def recording_of(trajectory: Trajectory, every: int = 1) -> Recording:
    """Return a native trajectory at a junction as a recording, with each ``every``-th row and the last one."""
    trial, rows = trajectory.trial, trajectory.rows
    assert trial.journey is None, "a journey crosses many junctions"
    assert not trajectory.looks_guessed, "an old trajectory does not tell its road users apart"
    kept = sorted({*range(0, len(rows), every), len(rows) - 1})
    users: dict[int, dict[int, RoadUser]] = {}
    for place, row in enumerate(kept):
        for number, user in zip(
            (trajectory.road_user_numbers or [()] * len(rows))[row], rows[row].road_users, strict=True
        ):
            users.setdefault(number, {})[place] = user
    return Recording(
        town=trial.town,
        approach=trial.approach,
        frame="town",
        units="m s rad m/s",
        reference="centre",
        length=VEHICLE.length,
        width=VEHICLE.width,
        route=trial.route.name,
        fault=trial.fault.kind,
        watch=trial.watch,
        scenery=trial.scenery,
        t=tuple(rows[k].t for k in kept),
        x=tuple(rows[k].x for k in kept),
        y=tuple(rows[k].y for k in kept),
        yaw=tuple(rows[k].yaw for k in kept),
        speed=tuple(rows[k].v for k in kept),
        # A native row has the command of the step that ends there.
        commands=tuple(Command(rows[min(k + 1, len(rows) - 1)].command).name for k in kept),
        others=tuple(_recorded(seen, len(kept)) for seen in users.values()),
    )


def _recorded(seen: dict[int, RoadUser], count: int) -> RecordedUser:
    length, width = next(iter(seen.values()))[3:5]
    x, y, yaw, speed = (tuple(seen[k][at] if k in seen else None for k in range(count)) for at in (0, 1, 2, 5))
    return RecordedUser(length=length, width=width, x=x, y=y, yaw=yaw, speed=speed)


def to_csv(recording: Recording) -> str:
    """Return a recording as CSV, which names no other road users, but says so if there were none."""
    fields: dict[str, Any] = recording.model_dump(mode="json", exclude_none=True, exclude={"others"})
    columns = {name: value for name, value in fields.items() if isinstance(value, list)}
    head = {**fields, **({"others": "none"} if recording.others == () else {})}
    out = io.StringIO()
    out.writelines(f"# {name}: {value}\n" for name, value in head.items() if name not in columns)
    writer = csv.writer(out, lineterminator="\n")
    writer.writerows([tuple(columns), *zip(*columns.values(), strict=True)])
    return out.getvalue()


def trials() -> Iterator[Trial]:
    """Yield half of the trials from the paper's open draw, with drawn scenery, and half with every other fault."""
    yield from load_suite("wrong-command@3").open_draw.episodes[: COUNT // 2]
    kinds = [kind for kind in available_faults() if not issubclass(fault_class(kind), Disturbance)]
    for number in range(COUNT - COUNT // 2):
        kind, towns = kinds[number % len(kinds)], ("Town01", "Town02", "junctions")
        town = load_town(towns[number % 3])
        places = [approach for approach in town.approaches if kind in faults_at(town, approach)]
        if not places:
            town = load_town("Town01")
            places = [approach for approach in town.approaches if kind in faults_at(town, approach)]
        traffic = Traffic(vehicles=12, pedestrians=8) if number % 2 else Traffic()
        trial = draw_trial(town, places[number % len(places)], kind, number, traffic=traffic)
        check_fault(trial)
        yield trial


def compare() -> str:
    """Drive all trials, and return the table: how much stays the same at each rate."""
    same: Counter[tuple[int, str]] = Counter()
    verdicts: Counter[str] = Counter()
    for number, trial in enumerate(trials()):
        driven = drive_trial(AGENTS[number % len(AGENTS)], trial).trajectory
        wanted = judge(driven, JudgeGeometry.of(town_of(trial), trial))
        verdicts[wanted.verdict] += 1
        for rate in (20, 10, 5):
            found, _ = judged(recording_of(driven, 20 // rate))
            same[rate, "verdict"] += found.verdict is wanted.verdict
            same[rate, "strict"] += found.unsafe_strict is wanted.unsafe_strict
            same[rate, "reaction"] += found.outcome is not None and found.outcome.reaction is wanted.reaction
            same[rate, "flags"] += found.outcome is not None and found.outcome.flags == wanted.flags
            if found.verdict is not wanted.verdict:
                print(f"{rate} Hz: {trial.id}: {wanted.verdict}, judged {found.verdict}", file=sys.stderr)
    heads = ("verdict", "strict", "reaction", "flags")
    lines = [f"| {rate} Hz | " + " | ".join(str(same[rate, head]) for head in heads) + " |" for rate in (20, 10, 5)]
    return "\n".join([*lines, ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common())])


def export(folder: Path, files: list[Path]) -> None:
    """Write native files as recordings: CSV, or JSON where there are other road users."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in files:
        content = read_unpacked(file)
        native = [content]
        if b'"episodes"' in content:
            episodes = RunFile.from_json(content, str(file)).episodes
            native = [json.dumps(one.trajectory).encode() for one in episodes if one.trajectory is not None]
        for trajectory in map(Trajectory.from_json, native):
            recording = recording_of(trajectory)
            text, ending = (recording.model_dump_json(), "json") if recording.others else (to_csv(recording), "csv")
            (folder / f"{trajectory.trial.id}.{ending}").write_text(text, "utf-8")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--export"]:
        export(Path(sys.argv[2]), [Path(one) for one in sys.argv[3:]])
    else:
        print(compare())
