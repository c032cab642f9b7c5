"""The gate obeys what the road offers, doubts the rest, and keeps a choice until the junction is left."""

import pytest
import torch
from torch import Tensor

from wrongturn_agents.models.gate import CHOICE, MEMORY, Gate, GateConfig
from wrongturn_protocol import Command

LEFT, RIGHT, STRAIGHT, FOLLOW, VOID = (
    int(Command.LEFT), int(Command.RIGHT), int(Command.STRAIGHT), int(Command.LANE_FOLLOW), int(Command.VOID),
)  # fmt: skip
T_LEFT_RIGHT, T_STRAIGHT_LEFT, T_STRAIGHT_RIGHT, CROSS = (1, 1, 0), (1, 0, 1), (0, 1, 1), (1, 1, 1)
SPEED = 5.0
WAY = [*torch.arange(35.0, 0.0, -0.5).tolist(), *[0.0] * 24, *[40.0] * 30]
"""Distance to the stop line at each decision of a drive at 5 m/s: towards a junction, through it, and away from it."""
LINE = WAY.index(0.0)
"""First decision inside the junction."""
AWAY = WAY.index(40.0)
"""First decision behind it."""


def drive(
    exits: tuple[int, int, int], commands: list[int], *, gate: Gate | None = None, distances: list[float] = WAY
) -> list[int]:
    """Return the command that is obeyed at each decision of a drive."""
    gate = gate or Gate()
    memory = torch.zeros(1, MEMORY)
    logits = 4.0 * (2.0 * torch.tensor([exits], dtype=torch.float32) - 1.0)
    obeyed = []
    for distance, command in zip(distances, commands, strict=True):
        got, memory = step(gate, logits, distance, command, memory)
        obeyed.append(got)
    return obeyed


def step(gate: Gate, logits: Tensor, distance: float, command: int, memory: Tensor) -> tuple[int, Tensor]:
    got, memory = gate(logits, torch.tensor([[distance]]), torch.tensor([[SPEED]]), torch.tensor([[command]]), memory)
    return int(got.item()), memory


def window(command: int, opens: float = 15.0, before: int = FOLLOW) -> list[int]:
    """Return a drive's commands: one direction from some metres before the line until 5 m past the junction."""
    return [command if distance <= opens and k < AWAY + 10 else before for k, distance in enumerate(WAY)]


@pytest.mark.parametrize("opens", [20.0, 15.0, 10.0])
@pytest.mark.parametrize(
    ("exits", "command"),
    [
        (T_LEFT_RIGHT, LEFT), (T_LEFT_RIGHT, RIGHT), (T_STRAIGHT_LEFT, STRAIGHT), (T_STRAIGHT_LEFT, LEFT),
        (T_STRAIGHT_RIGHT, RIGHT), (CROSS, STRAIGHT), (CROSS, LEFT), (CROSS, RIGHT),
    ],
)  # fmt: skip
def test_a_right_command_is_obeyed_throughout_the_junction(
    exits: tuple[int, int, int], command: int, opens: float
) -> None:
    obeyed = drive(exits, window(command, opens))
    assert set(obeyed[WAY.index(min(opens, 15.0) - 1.0) : AWAY]) == {command}
    assert set(obeyed[: WAY.index(25.0)]) == {FOLLOW}
    assert obeyed[-1] == FOLLOW


@pytest.mark.parametrize(
    ("exits", "command", "allowed"),
    [
        (T_LEFT_RIGHT, STRAIGHT, {LEFT, RIGHT}),
        (T_STRAIGHT_LEFT, RIGHT, {STRAIGHT}),
        (T_STRAIGHT_RIGHT, LEFT, {STRAIGHT}),
    ],
)
def test_a_missing_exit_is_replaced_by_one_that_exists(
    exits: tuple[int, int, int], command: int, allowed: set[int]
) -> None:
    obeyed = drive(exits, window(command))
    inside = set(obeyed[LINE - 8 : AWAY])
    assert len(inside) == 1
    assert inside <= allowed
    assert command not in obeyed


@pytest.mark.parametrize("silence", [FOLLOW, VOID])
@pytest.mark.parametrize("exits", [T_LEFT_RIGHT, T_STRAIGHT_LEFT, T_STRAIGHT_RIGHT, CROSS])
def test_without_a_command_an_exit_that_exists_is_chosen(exits: tuple[int, int, int], silence: int) -> None:
    obeyed = drive(exits, [silence] * len(WAY))
    inside = set(obeyed[LINE - 8 : AWAY])
    assert len(inside) == 1
    chosen = inside.pop()
    assert exits[chosen - LEFT] == 1
    assert obeyed[-1] == FOLLOW


def test_a_turn_where_no_junction_is_near_is_not_obeyed() -> None:
    assert set(drive((0, 0, 0), [LEFT] * 60, distances=[40.0] * 60)) == {FOLLOW}


@pytest.mark.parametrize(
    ("exits", "commands", "chosen"),
    [
        # It changes inside the junction, comes too late, flickers, is gone inside the junction.
        (T_LEFT_RIGHT, [RIGHT if k >= LINE + 2 else command for k, command in enumerate(window(LEFT))], {LEFT}),
        (T_STRAIGHT_LEFT, [FOLLOW if k <= LINE else LEFT for k in range(len(WAY))], {STRAIGHT}),
        (T_LEFT_RIGHT, [command if k % 2 else RIGHT for k, command in enumerate(window(LEFT))], {LEFT, RIGHT}),
        (T_STRAIGHT_RIGHT, [VOID if k > LINE else command for k, command in enumerate(window(RIGHT))], {RIGHT}),
    ],
)
def test_a_choice_holds_whatever_the_command_says_later(
    exits: tuple[int, int, int], commands: list[int], chosen: set[int]
) -> None:
    obeyed = set(drive(exits, commands)[LINE - 8 : AWAY])
    assert len(obeyed) == 1
    assert obeyed <= chosen


def test_a_wrong_picture_among_right_ones_changes_nothing() -> None:
    gate, memory = Gate(), torch.zeros(1, MEMORY)
    obeyed = []
    for k, (distance, command) in enumerate(zip(WAY, window(LEFT), strict=True)):
        logits = torch.tensor([[4.0, -4.0, 4.0]]) * (-1.0 if k % 5 == 0 else 1.0)
        got, memory = step(gate, logits, distance, command, memory)
        obeyed.append(got)
    assert set(obeyed[WAY.index(13.0) : AWAY]) == {LEFT}


def test_a_junction_that_is_seen_for_half_a_second_is_none() -> None:
    """As a car sees one that comes out of a bend askew: distances that jump are not driven."""
    distances = [*[40.0] * 20, 20.0, 3.5, 3.5, 5.0, 9.0, *[30.0] * 20]
    assert set(drive(T_STRAIGHT_LEFT, [FOLLOW] * len(distances), distances=distances)) == {FOLLOW}


def test_a_stop_line_that_is_seen_for_a_moment_behind_a_junction_is_none() -> None:
    """As a car sees one that is still turning when the gate ends its choice."""
    distances = [*WAY[: AWAY + 3], 5.5, 18.0, *[30.0] * 20]
    commands = [STRAIGHT] * len(distances)
    obeyed = drive(T_LEFT_RIGHT, commands, distances=distances)
    assert set(obeyed[AWAY + 3 :]) == {FOLLOW}


def test_nothing_is_left_of_a_junction_behind_the_car() -> None:
    """The second junction of a drive is judged by its own pictures."""
    gate = Gate()
    memory = torch.zeros(1, MEMORY)
    obeyed = []
    for exits, command in ((T_STRAIGHT_LEFT, LEFT), (T_STRAIGHT_RIGHT, LEFT)):
        logits = 4.0 * (2.0 * torch.tensor([exits], dtype=torch.float32) - 1.0)
        for distance, said in zip(WAY, window(command), strict=True):
            got, memory = step(gate, logits, distance, said, memory)
            obeyed.append(got)
    assert memory[0, CHOICE] == 0.0
    assert set(obeyed[LINE:AWAY]) == {LEFT}
    assert set(obeyed[len(WAY) + LINE : len(WAY) + AWAY]) == {STRAIGHT}


def test_a_choice_ends_even_if_the_junction_seems_to_have_no_end() -> None:
    distances = [*torch.arange(20.0, 0.0, -0.5).tolist(), *[0.0] * 100]
    obeyed = drive(T_LEFT_RIGHT, [FOLLOW] * len(distances), distances=distances)
    assert FOLLOW in obeyed[60:]


def test_ablations_let_their_wrong_commands_through() -> None:
    missing = drive(T_LEFT_RIGHT, window(STRAIGHT), gate=Gate(GateConfig(infeasible=False)))
    assert STRAIGHT in missing[LINE - 8 : AWAY]
    silent = drive(T_LEFT_RIGHT, [FOLLOW] * len(WAY), gate=Gate(GateConfig(omission=False)))
    assert set(silent) == {FOLLOW}
    commands = window(LEFT)
    commands[LINE + 2 :] = [RIGHT] * len(commands[LINE + 2 :])
    forgetful = drive(T_LEFT_RIGHT, commands, gate=Gate(GateConfig(memory=False)))
    assert {LEFT, RIGHT} <= set(forgetful[LINE - 8 : AWAY])
