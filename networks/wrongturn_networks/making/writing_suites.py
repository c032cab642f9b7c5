"""Recipes of the suites, and the text of their files."""

import hashlib
import json
from collections.abc import Callable
from typing import Final

from wrongturn_networks.draws import possible_trials
from wrongturn_networks.faults import check_fault
from wrongturn_networks.making.navigation import navigation
from wrongturn_networks.suites import canonical
from wrongturn_protocol import PAPER_TYPES, Cell, Fault, FaultKind, Track, Trial

PAPER_TOWN: Final = "Town01"
PAPER_FAULTS: Final = (FaultKind.INFEASIBLE, FaultKind.OMISSION)
SCORED: Final = (Track.CAMERA, Track.SEGMENTATION, Track.PRIVILEGED)


def _drawn_cells(per_cell: int) -> list[Cell]:
    """List the paper's cells, each ``per_cell`` times. An evaluation draws a trial from each."""
    cells = []
    for fault in PAPER_FAULTS:
        for kind in PAPER_TYPES:
            cell = Cell(town=PAPER_TOWN, junction_type=kind, fault=Fault(kind=fault))
            for trial in possible_trials(cell):
                check_fault(trial)
            cells += [cell] * per_cell
    return cells


SUITE_RECIPES: Final[dict[str, tuple[str, Callable[[], list[Trial] | list[Cell]]]]] = {
    "navigation@1": ("CoRL 2017's navigation: 4 tasks x 4 conditions x 25 routes", lambda: navigation(3001)),
    "smoke@2": ("Six trials for a first try, one for each of the paper's cells", lambda: _drawn_cells(1)),
    "wrong-command@2": (
        "The paper's benchmark with fresh trials: 3 junction types x 2 faults x 10 approaches",
        lambda: _drawn_cells(10),
    ),
}
"""Title of each suite, and its trials or cells."""


def suite_text(suite_id: str) -> str:
    """Return the text of the file of a suite in :data:`SUITE_RECIPES`.

    Raises:
        FaultNotApplicableError: the recipe asks for a fault where it cannot be applied.
    """
    title, recipe = SUITE_RECIPES[suite_id]
    content_of = recipe()
    kind = "cells" if isinstance(content_of[0], Cell) else "trials"
    name, version = suite_id.split("@")
    content = {
        "name": name,
        "version": int(version),
        "title": title,
        "tracks": [str(track) for track in SCORED],
        kind: [one.model_dump(mode="json") for one in content_of],
    }
    sha256 = hashlib.sha256(canonical(content)).hexdigest()
    return json.dumps({"sha256": sha256, **content}, indent=1) + "\n"
