"""What each fault delivers along the way, where it can be applied, and what it says of a trial."""

import itertools
import math
from pathlib import Path
from typing import Any, Final

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_networks import FaultNotApplicableError, SceneryKind, draw_trial, faults, load_town, town_of
from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.draws import draw_cells, placed, possible_trials
from wrongturn_networks.faults import Ending, Guidance, Passage
from wrongturn_protocol import (
    DIRECTIONS,
    Cell,
    Command,
    Fault,
    FaultKind,
    JunctionType,
    Outcome,
    Reaction,
    Start,
    Trial,
    Verdict,
)

ROOT = Path(__file__).parents[2]
INNER, LANE = 20.0, 60.0
"""Metres from the stop line to the exit line, and from there to the next stop line."""
LETTERS: Final = {
    Command.LEFT: "L",
    Command.RIGHT: "R",
    Command.STRAIGHT: "S",
    Command.LANE_FOLLOW: "f",
    Command.VOID: "-",
}
LEFT_RIGHT, CROSS = JunctionType.LEFT_RIGHT, JunctionType.CROSS
FAULTS = tuple(
    kind
    for kind in faults.available_faults()
    if kind is not FaultKind.NONE and not issubclass(faults.fault_class(kind), Disturbance)
)


def a_trial(fault: Fault, junction_type: JunctionType = LEFT_RIGHT, seed: int = 0, **more: Any) -> Trial:
    given: dict[str, Any] = {"route": min(junction_type.exits), "next_route": Command.STRAIGHT, **more}
    start = Start(distance=90.0, speed=6.0, lateral=0.0, yaw=0.0)
    fields = {"id": "t", "town": "Town01", "approach": "J3-S", "junction_type": junction_type, "start": start}
    return Trial(fault=fault, seed=seed, **{**fields, **given})


def guided(trial: Trial, s: float) -> Guidance:
    """What the route says ``s`` metres past the stop line; the next junction is a crossing."""
    window = trial.window or 15.0
    here = Passage(trial.route, trial.junction_type.exits, -s, INNER - s, True)
    if s < INNER:
        command = trial.route if s >= -window else Command.LANE_FOLLOW
        return Guidance(command, window, here)
    beyond = INNER + LANE - s
    after = Passage(trial.next_route or Command.STRAIGHT, CROSS.exits, beyond, beyond + INNER, False)
    return Guidance(trial.route if s <= INNER + 5.0 else Command.LANE_FOLLOW, window, after, here)


def commands(trial: Trial, begin: int = -90, end: int = 60) -> list[Command]:
    """The command at each metre; the car drives at 10 m/s, so each is a decision."""
    fault = faults.make_fault(trial)
    return [fault.deliver((s - begin) / 10.0, guided(trial, s)) for s in range(begin, end)]


def runs(trial: Trial) -> str:
    return " ".join(f"{LETTERS[one]}{len(list(some))}" for one, some in itertools.groupby(commands(trial)))


@pytest.mark.parametrize(
    ("fault", "more", "expected"),
    [
        # From 90 m before the stop line on. The window is 15 m before to 25 m past it, the exit line 20 m past it.
        ({"kind": "infeasible"}, {}, "f75 S41 f34"),
        ({"kind": "omission"}, {}, "f150"),
        ({"kind": "substitution"}, {}, "f75 R41 f34"),
        ({"kind": "substitution"}, {"junction_type": CROSS, "seed": 1}, "f75 S41 f34"),
        ({"kind": "prohibited"}, {}, "f75 R41 f34"),
        ({"kind": "commission"}, {}, "f20 R31 f24 L41 f34"),
        ({"kind": "commission"}, {"junction_type": CROSS, "route": 3, "next_route": 1}, "f20 L31 f24 S41 f34"),
        ({"kind": "early"}, {}, "f55 L41 f39 S15"),
        ({"kind": "early", "dose": 40}, {"window": 20.0}, "f30 L46 f34 S40"),
        ({"kind": "late"}, {}, "f90 L41 f19"),
        ({"kind": "late", "dose": 20}, {"window": 10.0}, "f100 L36 f14"),
        ({"kind": "stuck"}, {}, "R150"),
        ({"kind": "stuck"}, {"seed": 1}, "S150"),
        ({"kind": "sequence"}, {}, "f75 S41 f34"),
        ({"kind": "flicker"}, {}, "f75 L5 S5 L5 S5 L5 S5 L5 S5 L1 f34"),
        ({"kind": "flicker", "dose": 0.25, "period": 2}, {"seed": 3}, "f75 L2 S5 L15 S5 L14 f34"),
        ({"kind": "reversal"}, {}, "f75 L20 R21 f34"),
        ({"kind": "reversal", "dose": 0}, {"seed": 1}, "f75 L15 S26 f34"),
        ({"kind": "dropout"}, {}, "f75 -21 L20 f34"),
        ({"kind": "dropout", "dose": 1}, {}, "f75 -41 f34"),
        ({"kind": "corrected"}, {}, "f75 S10 L31 f34"),
        ({"kind": "corrected", "dose": -10}, {}, "f75 S25 L16 f34"),
    ],
)
def test_golden_sequences(fault: dict[str, Any], more: dict[str, Any], expected: str) -> None:
    assert runs(a_trial(Fault(**fault), **more)) == expected


@st.composite
def trials(draw: st.DrawFn) -> Trial:
    """Any trial that its fault accepts, with any dose."""
    kind = draw(st.sampled_from(FAULTS))
    built, numbers = faults.fault_class(kind), {}
    for name, dose in (("dose", built.dose), ("period", built.period)):
        if dose is not None and draw(st.booleans()):
            numbers[name] = draw(st.floats(dose.low, dose.high))
    lacks = kind in {FaultKind.INFEASIBLE, FaultKind.CORRECTED}
    types = [one for one in JunctionType if one.missing is not None or not lacks]
    junction_type = draw(st.sampled_from(types))
    route = draw(st.sampled_from(sorted(junction_type.exits)))
    onward = draw(st.sampled_from([one for one in DIRECTIONS if one is not route]))
    window = draw(st.none() | st.floats(10.0, 20.0))
    seed = draw(st.integers(0, 2**31))
    return a_trial(Fault(kind=kind, **numbers), junction_type, seed, route=route, next_route=onward, window=window)


@given(trials())
def test_a_fault_keeps_to_its_window_its_seed_and_its_word(trial: Trial) -> None:
    told, kind, built = commands(trial), trial.fault.kind, faults.fault_class(trial.fault.kind)
    assert told == commands(trial)
    assert told == commands(trial.model_copy(update={"id": "another"}))
    window, amount = trial.window or 15.0, built.amount_of(trial.fault)
    shift = {FaultKind.EARLY: -amount, FaultKind.LATE: amount}.get(kind, 0.0)
    lines = (0.0, INNER + LANE)
    stretches = [(line - window + min(shift, 0.0), line + INNER + 5.0 + max(shift, 0.0)) for line in lines]
    stretches += [(-70.0, -40.0)] * (kind is FaultKind.COMMISSION) + [(-90.0, 60.0)] * (kind is FaultKind.STUCK)
    for s, command in zip(range(-90, 60), told, strict=True):
        usual = guided(trial, s).command
        assert command is usual or any(low <= s <= high for low, high in stretches), s
    at_the_junction = told[90 - 30 : 90 + 20]
    wrong = set(at_the_junction) - {trial.route, Command.LANE_FOLLOW, Command.VOID}
    closed = built.closed(trial)
    misled = kind not in {FaultKind.EARLY, FaultKind.LATE, FaultKind.DROPOUT, FaultKind.OMISSION, FaultKind.COMMISSION}
    seen = not misled or not wrong <= trial.junction_type.exits or closed in wrong
    if kind is FaultKind.CONTRADICTION:  # the command is right, what is said beside it is not
        misled, seen = False, trial.junction_type.missing is not None
    assert built.detectable(trial) == seen
    assert len(wrong) == misled


@pytest.mark.parametrize("kind", faults.available_faults())
def test_a_fault_says_all_about_itself(kind: FaultKind) -> None:
    built = faults.fault_class(kind)
    assert built.words.endswith(".")
    assert bool(built.guide_word) == (kind is not FaultKind.NONE) == bool(built.reactions)
    page, numbers = (ROOT / "docs" / "faults.md").read_text(), []
    for name, dose in (("dose", built.dose), ("period", built.period)):
        if dose is not None:
            assert all(dose.low <= one <= dose.high for one in (dose.usual, *dose.suites))
            unit, listed = f" {dose.unit}".rstrip(), ", ".join(f"{one:g}" for one in dose.suites)
            within = f"{dose.low:g} to {dose.high:g}{unit}, usually {dose.usual:g}; suites: {listed}"
            numbers.append(f"`{name}`: {dose.meaning}, {within}")
    row = f"| [`{kind}`](#{kind}) | {built.guide_word} | {built.onset} | {built.end} | {'. '.join(numbers) or '–'} |"
    assert kind is FaultKind.NONE or (f"{row} {built.drawn} |" in page and f"## {kind}\n" in page)
    assert "LEFT" in built.told(a_trial(Fault(kind=kind)), lambda word: word.name)


@pytest.mark.parametrize(
    ("fault", "more", "message"),
    [
        ({"kind": "late", "dose": 31}, {}, r"^fault\.dose: is 31; give how much too late it comes, 1 to 30 m$"),
        ({"kind": "flicker", "period": 0}, {}, r"^fault\.period: is 0; give the time after"),
        ({"kind": "stuck", "dose": 1}, {}, r"^fault\.dose: stuck has none; leave it out$"),
        ({"kind": "early", "dose": 60}, {"start": Start(distance=70, speed=6, lateral=0, yaw=0)}, "smaller dose"),
        ({"kind": "commission"}, {"start": Start(distance=70, speed=6, lateral=0, yaw=0)}, "whose lane is longer"),
        ({"kind": "sequence"}, {"next_route": None}, "needs a route that takes another direction"),
        ({"kind": "sequence"}, {"next_route": Command.LEFT}, "next_route LEFT; draw the trial"),
        ({"kind": "corrected"}, {"junction_type": CROSS}, "has all three; take another"),
        ({"kind": "corrected", "dose": 9}, {"window": 8.0}, "give a dose below 8 m"),
    ],
)
def test_a_refusal_names_the_remedy(fault: dict[str, Any], more: dict[str, Any], message: str) -> None:
    with pytest.raises(FaultNotApplicableError, match=message):
        faults.check_fault(a_trial(Fault(**fault), **more))


def ended(verdict: Verdict, exit_: Command | None = None, *, engaged: bool = True, side: bool = True) -> Ending:
    return Ending(verdict, exit_, engaged, lambda _: side)


@pytest.mark.parametrize(
    ("kind", "ending", "expected"),
    [
        ("substitution", ended(Verdict.EXIT_COMMANDED, Command.RIGHT), "obeyed"),
        ("substitution", ended(Verdict.EXIT_ROUTE, Command.LEFT), "overrode"),
        ("substitution", ended(Verdict.OFF_ROAD), "other"),
        ("prohibited", ended(Verdict.COLLISION), "obeyed"),
        ("prohibited", ended(Verdict.COLLISION, side=False), "other"),
        ("commission", ended(Verdict.OFF_ROAD, engaged=False), "obeyed"),
        ("commission", ended(Verdict.NOT_ENGAGED, engaged=False), "froze"),
        ("commission", ended(Verdict.EXIT_COMMANDED, Command.LEFT), "exit"),
        ("commission", ended(Verdict.OFF_ROAD), "other"),
        ("early", ended(Verdict.OFF_ROAD, engaged=False, side=False), "obeyed"),
        ("early", ended(Verdict.OFF_ROAD, side=False), "other"),
        ("late", ended(Verdict.EXIT_OTHER, Command.RIGHT), "exit"),
        ("dropout", ended(Verdict.STOPPED_BEFORE_JUNCTION), "froze"),
        ("corrected", ended(Verdict.OFF_ROAD), "obeyed"),
        ("corrected", ended(Verdict.EXIT_COMMANDED, Command.LEFT), "overrode"),
    ],
)
def test_reactions(kind: str, ending: Ending, expected: str) -> None:
    trial = a_trial(Fault(kind=FaultKind(kind)))
    assert faults.fault_class(trial.fault.kind).reaction(trial, ending) is Reaction(expected)


def test_at_a_crossing_flicker_names_two_exits_and_each_is_complied_with() -> None:
    trial, built = a_trial(Fault(kind=FaultKind.FLICKER), CROSS), faults.fault_class(FaultKind.FLICKER)
    assert not built.detectable(trial)
    exits = {one: Outcome(verdict=Verdict.EXIT_OTHER, exit=one, time=1, max_deceleration=0) for one in DIRECTIONS}
    assert sorted(one for one, outcome in exits.items() if built.complied(trial, outcome)) == sorted(
        set(commands(trial)) - {Command.LANE_FOLLOW}
    )


@pytest.mark.parametrize("town_name", ["Town01", "Town02", "junctions"])
def test_whatever_is_offered_can_be_drawn_by_any_seed_and_by_suites(town_name: str) -> None:
    town = load_town(town_name)
    for approach in town.approaches.values():
        for kind in faults.faults_at(town, approach.id):
            for seed in range(4):
                trial = draw_trial(town, approach.id, kind, seed)
                faults.check_fault(trial)
    if town_name == "junctions":
        return
    # Where the lane is long, as a commission needs.
    cells = [Cell(town=town_name, junction_type=JunctionType.STRAIGHT_LEFT, fault=Fault(kind=kind)) for kind in FAULTS]
    for trial in (
        *draw_cells("mine@1", cells, "secret").trials,
        *(one for cell in cells for one in possible_trials(cell)),
    ):
        faults.check_fault(trial)
        assert trial.start.distance > 70.0 or trial.fault.kind is not FaultKind.COMMISSION


def test_a_cell_moves_to_the_next_drawn_town_where_its_own_has_no_lane_for_it() -> None:
    towns = {"drawn 0": "Town01", "drawn 1": "Town02"}
    for kind, label in ((FaultKind.COMMISSION, "drawn 0"), (FaultKind.LATE, "drawn 1")):
        cell = Cell(town="drawn 1", junction_type=LEFT_RIGHT, fault=Fault(kind=kind))
        assert placed(cell, towns) == cell.model_copy(update={"town": label})


def test_boards_close_the_street_that_the_command_names() -> None:
    town = load_town("Town01")
    for seed, approach in enumerate(town.approaches.values()):
        trial = draw_trial(town, approach.id, FaultKind.PROHIBITED, seed)
        closed, here = faults.closed_exit(trial), town_of(trial)
        assert closed not in {None, trial.route}
        leaving = town.lanes[approach.exits[closed].lane]
        assert here.closed == (leaving.id, leaving.opposite)
        assert here.sha256 != town.sha256
        boards = [thing for thing in here.scenery if thing.kind is SceneryKind.BOARD]
        assert here.scenery[: len(town.scenery)] == town.scenery
        assert sum(board.length for board in boards) == pytest.approx(
            leaving.width + town.lanes[leaving.opposite or ""].width, abs=0.01
        )
        x, y = leaving.centreline[0]
        assert min(math.dist((board.x, board.y), (x, y)) for board in boards) == pytest.approx(1.0, abs=0.2)
        assert town_of(trial.twin()) is town
