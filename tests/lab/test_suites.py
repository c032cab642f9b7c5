from collections import Counter
from itertools import product

import pytest

from lab import suites
from lab.suites import FAULTS, NEW_WEATHERS, SETTINGS, paper_cells
from wrongturn_networks import load_suite, suite_ids
from wrongturn_networks.draws import is_drawn_cell
from wrongturn_networks.faults import check_fault, fault_class
from wrongturn_protocol import PAPER_TYPES, Cell, JunctionType
from wrongturn_protocol.intervals import town_of


def test_every_shipped_suite_is_what_its_recipe_gives():
    assert set(suites.RECIPES) == set(suite_ids())
    assert suites.differing() == []


def test_the_extended_suite_is_balanced():
    cells = load_suite("wrong-command-extended@1").cells
    ours = paper_cells(4)
    assert list(cells[: len(ours)]) == ours
    rest = cells[len(ours) :]
    assert not set(ours) & set(rest)

    def setting(cell: Cell) -> tuple[bool, bool]:
        return cell.weather in NEW_WEATHERS, cell.traffic.vehicles > 0

    def town(cell: Cell) -> str:
        return "drawn" if is_drawn_cell(cell) else cell.town

    # Every fault meets every type in every setting, and there each kind of town once at its T-junctions.
    for fault in FAULTS:
        own = [cell for cell in rest if cell.fault.kind is fault]
        types = sorted({cell.junction_type for cell in own})
        assert set(types) >= set(PAPER_TYPES)
        assert Counter((cell.junction_type, setting(cell)) for cell in own) == Counter(
            product(types, product((False, True), repeat=2))
        )
        tees = [(town(cell), setting(cell)) for cell in own if cell.junction_type is not JunctionType.CROSS]
        assert Counter(tees) == Counter(product(("Town01", "Town02", "drawn"), product((False, True), repeat=2)))
        dose = fault_class(fault).dose
        doses = Counter(cell.fault.dose for cell in own)
        assert set(doses) == ({None} if dose is None else set(dose.suites))
        assert max(doses.values()) - min(doses.values()) <= 1
    # Each weather of a setting, each drawn town, and each town of a type comes about as often.
    for levels, apart in (
        (Counter(cell.weather for cell in rest if cell.weather in NEW_WEATHERS), 0),
        (Counter(cell.weather for cell in rest if cell.weather not in NEW_WEATHERS), 2),
        (Counter(cell.town for cell in rest if is_drawn_cell(cell)), 0),
        (Counter((cell.junction_type, town(cell)) for cell in rest if cell.junction_type in PAPER_TYPES), 3),
        (Counter((setting(cell), town(cell)) for cell in rest if not is_drawn_cell(cell)), 0),
    ):
        assert max(levels.values()) - min(levels.values()) <= apart, levels
    assert len(SETTINGS) * len(FAULTS) * 3 + 4 * 11 == len(rest)


@pytest.mark.parametrize("secret", ["wrong-command-extended@1", pytest.param("another", marks=pytest.mark.soak)])
def test_every_fault_of_the_extended_suite_applies_wherever_a_draw_leads(secret):
    suite = load_suite("wrong-command-extended@1")
    draw = suite.draw(secret)
    assert len({trial.id for trial in draw.episodes}) == 2 * len(suite.cells)
    assert len({town for trial in draw.trials if (town := town_of(trial.town))}) >= 8
    for trial in draw.episodes:
        check_fault(trial)
