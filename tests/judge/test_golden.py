"""Stored records keep their outcomes. A change of scoring on purpose changes them, and the changelog says which."""

import json
from pathlib import Path

import pytest
from golden_drives import FOLDER, GOLDEN
from handmade_junction import junction, mirrored, mirrored_rows, mirrored_trial, verdict_of

from wrongturn_judge import judge
from wrongturn_judge.trajectory import Trajectory
from wrongturn_protocol import Flag, Outcome, Reaction, Verdict

FILES = sorted(FOLDER.glob("*.json"))
EXPECTED = {
    "exit-commanded-left": (Verdict.EXIT_COMMANDED, None, ()),
    "exit-route-overrides": (Verdict.EXIT_ROUTE, Reaction.OVERRODE, ()),
    "exit-other-rides-the-kerb": (Verdict.EXIT_OTHER, Reaction.EXIT, (Flag.KERB_RIDE,)),
    "off-road-obeys-straight": (Verdict.OFF_ROAD, Reaction.OBEYED, ()),
    "collision-obeys-left": (Verdict.COLLISION, Reaction.OBEYED, ()),
    "collision-with-a-car": (Verdict.COLLISION, None, ()),
    "stopped-before-over-the-line": (Verdict.STOPPED_BEFORE_JUNCTION, Reaction.FROZE, ()),
    "stopped-in-junction": (Verdict.STOPPED_IN_JUNCTION, Reaction.FROZE, ()),
    "wrong-way-by-the-oncoming-lane": (Verdict.WRONG_WAY, None, (Flag.OPPOSED_LANE,)),
    "off-road-after-an-exit": (Verdict.OFF_ROAD, Reaction.OBEYED, ()),
    "stopped-with-its-tail-in-the-junction": (Verdict.STOPPED_IN_JUNCTION, Reaction.FROZE, ()),
    "stopped-across-the-lane": (Verdict.STOPPED_BEFORE_JUNCTION, None, (Flag.OPPOSED_LANE, Flag.STOPPED_ACROSS)),
    "unfinished-past-the-junction": (Verdict.UNFINISHED, None, ()),
    "exit-at-60-km-h": (Verdict.EXIT_COMMANDED, None, (Flag.SPEEDING,)),
    "not-engaged": (Verdict.NOT_ENGAGED, Reaction.OTHER, ()),
}


def test_every_record_is_expected() -> None:
    assert {path.stem for path in FILES} == set(GOLDEN) == set(EXPECTED)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_a_golden_record_keeps_its_outcome(path: Path) -> None:
    stored = json.loads(path.read_text(encoding="ascii"))
    trajectory = Trajectory.from_json(json.dumps(stored["trajectory"]))
    geometry = junction(trajectory.trial.junction_type, solids=stored["solids"])
    outcome = judge(trajectory, geometry)
    assert outcome == Outcome.model_validate(stored["outcome"])
    assert (outcome.verdict, outcome.reaction, outcome.flags) == EXPECTED[path.stem]
    assert outcome.time == trajectory.rows[-1].t
    there = verdict_of(mirrored_rows(trajectory.rows), mirrored(geometry), mirrored_trial(trajectory.trial))
    assert (there.verdict, there.reaction, there.flags) == EXPECTED[path.stem]
