"""Faults without the simulation: plans of other programs, one-hot commands, and a package that needs nothing."""

import ast
import math
import subprocess
import sys
from collections.abc import Callable, Sequence
from enum import Enum
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

import wrongturn_faults
from wrongturn_faults import (
    CARLA,
    DOSES,
    NAVSIM,
    RULES,
    Command,
    carla,
    faulty_plan,
    from_one_hot,
    junctions_of,
    one_hot,
)
from wrongturn_networks import load_town
from wrongturn_networks.faults import available_faults, find_fault

FOLDER = Path(wrongturn_faults.__file__).parent
L, R, S, F, V = Command.LEFT, Command.RIGHT, Command.STRAIGHT, Command.LANE_FOLLOW, Command.VOID


class RoadOption(Enum):
    """As in CARLA's agents."""

    VOID = -1
    LEFT = 1
    RIGHT = 2
    STRAIGHT = 3
    LANEFOLLOW = 4
    CHANGELANELEFT = 5
    CHANGELANERIGHT = 6


def plan() -> tuple[list[tuple[float, float]], list[int]]:
    """Return a way through two junctions of Town01, a point each metre, as a planner of CARLA gives it."""
    town = load_town("Town01")
    approach = next(
        one for one in town.approaches.values() if {L, S} == set(one.exits) and town.lanes[one.lane].length > 60
    )
    points: list[tuple[float, float]] = []
    commands: list[int] = []

    def add(line: Any, command: int) -> None:
        for (x, y), (x2, y2) in pairwise(line.tolist()):
            steps = max(1, round(math.hypot(x2 - x, y2 - y)))
            points.extend((x + (x2 - x) * k / steps, y + (y2 - y) * k / steps) for k in range(steps))
            commands.extend([command] * steps)

    lane = town.lanes[approach.lane]
    for direction in (S, None):
        add(lane.centreline, F)
        following = town.approach_of_lane(lane.id)
        assert following is not None
        leaving = following.exits.get(direction or next(iter(following.exits)))
        assert leaving is not None
        add(leaving.path, int(leaving.direction))
        lane = town.lanes[leaving.lane]
    add(lane.centreline[:2], F)
    return points, commands


def told(fault: str, **options: Any) -> list[tuple[int, int]]:
    """Return the runs of one command around the first junction: command and number of rows."""
    points, commands = plan()
    runs: list[tuple[int, int]] = []
    found = faulty_plan(points, commands, fault, exits=(L, S), **options)
    first, second = junctions_of(commands)
    for command in found[: (first.end + second.begin) // 2]:
        runs = [*runs[:-1], (command, runs[-1][1] + 1)] if runs and runs[-1][0] == command else [*runs, (command, 1)]
    return runs


def test_what_the_agent_is_told_on_a_plan_of_town01() -> None:
    assert [one for one, _ in told("none")] == [F, S, F]
    assert [one for one, _ in told("infeasible")] == [F, R, F]
    assert [one for one, _ in told("omission")] == [F]
    assert [one for one, _ in told("substitution")] == [F, L, F]
    assert [one for one, _ in told("corrected")] == [F, R, S, F]
    assert [one for one, _ in told("dropout")] == [F, V, S, F]
    assert [one for one, _ in told("stuck")] == [L]
    assert [one for one, _ in told("reversal", seed=1)] == [F, S, R, F]
    late, right, early = told("late", dose=10), told("none"), told("early", dose=10)
    assert late[0][1] - right[0][1] == pytest.approx(10, abs=1.1)
    assert right[0][1] - early[0][1] == pytest.approx(10, abs=1.1)
    assert {one for one, _ in told("flicker")} == {F, S, R}


@given(st.sampled_from(sorted(RULES)), st.integers(0, 2**31), st.integers(0, 1))
def test_rows_far_from_the_junction_and_lane_changes_stay(fault: str, seed: int, junction: int) -> None:
    points, commands = plan()
    commands[5] = 6
    found = faulty_plan(points, commands, fault, junction=junction, seed=seed)
    assert len(found) == len(points)
    assert fault == "stuck" or junction == 0 or found[:40] == commands[:40]
    assert fault in {"stuck", "omission", "late", "early"} or found[5] == 6
    assert found == faulty_plan(points, commands, fault, junction=junction, seed=seed)


def test_every_fault_of_the_simulation_has_its_rule_and_dose() -> None:
    for kind in available_faults():
        fault = find_fault(kind)
        assert fault is not None
        if fault.__module__.startswith("wrongturn_networks.faults"):
            assert kind in RULES
            assert DOSES.get(kind) == (None if fault.dose is None else fault.dose.usual)


AGENT = """
class Plain:
    def set_global_plan(self, gps, world):
        self.plan = gps, world
class MyAgent(Plain):
    pass
def get_entry_point():
    return "MyAgent"
"""


@pytest.fixture
def agent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Return what an agent of CARLA's leaderboard has after it got its plan, with variables of the environment."""
    (tmp_path / "mine.py").write_text(AGENT, "utf-8")

    def driven(**variables: str) -> Any:
        for name in ("FAULT", "DOSE", "SEED", "EXITS", "JUNCTION", "WINDOW", "PERIOD"):
            monkeypatch.delenv(f"WRONGTURN_{name}", raising=False)
        for name, value in {"WRONGTURN_AGENT": str(tmp_path / "mine.py"), **variables}.items():
            monkeypatch.setenv(name, value)
        one = getattr(carla, carla.get_entry_point())()
        points, commands = plan()
        options = [RoadOption(command) for command in commands]
        gps = [{"lat": y / 111_319.49, "lon": x / 111_319.49, "z": 0.0} for x, y in points]
        world = [SimpleNamespace(location=SimpleNamespace(x=x, y=y, z=0.0)) for x, y in points]
        one.set_global_plan(list(zip(gps, options, strict=True)), list(zip(world, options, strict=True)))
        return one.plan

    return driven


def test_an_agent_of_carlas_leaderboard_gets_a_faulty_plan(agent: Callable[..., Any]) -> None:
    right, _ = agent()
    gps, world = agent(WRONGTURN_FAULT="infeasible", WRONGTURN_EXITS="1,3")
    assert [point for point, _ in gps] == [point for point, _ in right], "places stay"
    assert [option for _, option in gps] == [option for _, option in world]
    changed = [(was, now) for (_, was), (_, now) in zip(right, gps, strict=True) if was is not now]
    assert {now for _, now in changed} == {RoadOption.RIGHT}
    assert RoadOption.STRAIGHT in {was for was, _ in changed}


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"WRONGTURN_FAULT": "infeasable"}, "fault: 'infeasable' is not known"),
        ({"WRONGTURN_FAULT": "late", "WRONGTURN_DOSE": "far"}, "WRONGTURN_DOSE: is 'far'"),
        ({"WRONGTURN_FAULT": "late", "WRONGTURN_DOSE": "nan"}, "dose: is nan"),
        ({"WRONGTURN_FAULT": "omission", "WRONGTURN_DOSE": "3"}, "dose: is 3.0, and omission has none"),
        ({"WRONGTURN_FAULT": "infeasible", "WRONGTURN_EXITS": "left"}, "WRONGTURN_EXITS: is 'left'"),
        ({"WRONGTURN_FAULT": "infeasible", "WRONGTURN_EXITS": "1,2"}, "exits: are"),
        ({"WRONGTURN_FAULT": "infeasible", "WRONGTURN_JUNCTION": "7"}, "junction: is 7; the plan has 2"),
        ({"WRONGTURN_FAULT": "infeasible", "WRONGTURN_WINDOW": "-1"}, "window: is -1.0"),
        ({"WRONGTURN_AGENT": "nowhere.py"}, "WRONGTURN_AGENT: is 'nowhere.py'"),
    ],
)
def test_mistakes_name_the_setting(agent: Callable[..., Any], variables: dict[str, str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        agent(**variables)


@pytest.mark.parametrize(
    ("points", "commands", "said"),
    [
        ([], [], "points: is empty"),
        ([(0.0, 0.0)], [], "commands: has 0 rows"),
        ([(0.0, 0.0)] * 3, [4] * 3, "leads through no junction"),
        ([(0.0, 0.0), (math.nan, 0.0)], [4, 1], "not finite"),
    ],
)
def test_plans_that_are_none(points: Sequence[tuple[float, float]], commands: Sequence[int], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        faulty_plan(points, commands, "omission")


def test_one_hot_commands() -> None:
    assert one_hot(L, NAVSIM) == [1, 0, 0, 0]
    assert one_hot(F, NAVSIM) == [0, 1, 0, 0]
    assert one_hot(V, NAVSIM) == [0, 0, 0, 1]
    assert one_hot(V, CARLA, 6) == [0, 0, 0, 1, 0, 0]
    for order in (NAVSIM, CARLA):
        assert [from_one_hot(one_hot(command, order), order) for command in order] == list(order)
    with pytest.raises(ValueError, match="vector"):
        from_one_hot([1, 1, 0, 0], NAVSIM)


def test_it_runs_alone_and_on_python_3_8(tmp_path: Path) -> None:
    for file in FOLDER.glob("*.py"):
        ast.parse(file.read_text("utf-8"), feature_version=(3, 8))
    code = f"import sys; sys.path.insert(0, {str(FOLDER.parent)!r}); import wrongturn_faults as f; print(len(f.RULES))"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert int(done.stdout) == len(RULES)
