"""The writing of a suite's file."""

import hashlib
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from wrongturn_networks.draws import is_drawn_cell, possible_trials
from wrongturn_networks.faults import check_fault
from wrongturn_networks.loading import TOWNS, load_town
from wrongturn_networks.suites import canonical
from wrongturn_protocol import Cell, Track, Trial

SCORED: Final = (Track.CAMERA, Track.SEGMENTATION, Track.PRIVILEGED)
Content = Sequence[Trial | Cell]


def write_suite(file: Path, title: str, content: Content, tracks: Sequence[Track] = SCORED) -> None:
    """Write a suite's file.

    Args:
        file: Its name is the suite's id. Example: ``junction-tour@1.json``
        title: The suite in a line.
        content: Cells, from which each evaluation draws its own trials; or trials, the same for all.
        tracks: Tracks in which the suite is driven for a score.

    Raises:
        ValueError: the file's name is no suite's id, or there is no content.
        NetworkError: a fault or a start is not possible in a cell or trial; the message says which and why.
        FileExistsError: the file holds another suite. Suites never change: give this one a new version.
    """
    text = suite_text(file.name.removesuffix(".json"), title, content, tracks)
    if file.exists() and file.read_text("utf-8") != text:
        raise FileExistsError(f"{file} holds another suite, and suites never change; give this one a new version")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, "utf-8")


def suite_text(suite_id: str, title: str, content: Content, tracks: Sequence[Track] = SCORED) -> str:
    """Return the text of a suite's file. Raises ValueError and NetworkError as :func:`write_suite`."""
    name, _, version = suite_id.partition("@")
    if not (name and version.isdecimal()):
        raise ValueError(f"file: {suite_id!r} is no suite's id; name the file NAME@VERSION.json, such as tour@1.json")
    if not content:
        raise ValueError("content: is empty; give one trial or cell at least")
    for one in dict.fromkeys(content):
        trials: Iterable[Trial] = possible_trials(one) if isinstance(one, Cell) else (one,)
        for trial in trials:
            check_fault(trial)
    places = sorted({one.town for one in content if not (isinstance(one, Cell) and is_drawn_cell(one))})
    towns = {town: load_town(town).sha256 for town in places if not (TOWNS / town).is_dir()}
    told = {
        "name": name,
        "version": int(version),
        "title": title,
        "tracks": [str(track) for track in tracks],
        **({"towns": towns} if towns else {}),
        "cells" if isinstance(content[0], Cell) else "trials": [one.model_dump(mode="json") for one in content],
    }
    return json.dumps({"sha256": hashlib.sha256(canonical(told)).hexdigest(), **told}, indent=1) + "\n"
