"""A film of each fault, for ``docs/faults.md``: ``python -m lab.fault_films`` makes them and writes their lines there.

``ppo-segmentation`` drives trials of the fault until one is telling. Below the picture, a strip shows the command that
was delivered (above) and the route's, and moves with the drive.
"""

import hashlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from lab.films import drive_trial
from lab.in_process import DrivenEpisode
from wrongturn_networks import NetworkError, draw_trial, load_town
from wrongturn_networks.faults import available_faults, check_fault, fault_class
from wrongturn_protocol import Command, FaultKind, Trial, View
from wrongturn_protocol.words import COMMANDS
from wrongturn_service.web import words
from wrongturn_sim import Replay
from wrongturn_sim.view.film import write_film
from wrongturn_sim.view.window import Image

PAGE: Final = Path("docs/faults.md")
FILMS: Final = Path("docs/pictures/faults")
AGENT: Final = "ppo-segmentation"
_TRIES: Final = 24
"""Trials that are driven at most, until one is unsafe or takes another exit than the route's."""
_SIZE, _EVERY, _RATE, _LONGEST_S = 280, 2, 5, 9.0
_ROW: Final = 14
"""Height of each of the strip's two rows, pixels."""
_COLOURS: Final = {
    Command.LEFT: (58, 110, 200),
    Command.RIGHT: (214, 120, 40),
    Command.STRAIGHT: (70, 150, 80),
    Command.LANE_FOLLOW: (205, 205, 205),
    Command.VOID: (255, 255, 255),
}


def trials_of(kind: FaultKind) -> Iterator[Trial]:
    """Yield trials to try, at one approach after the other."""
    town = load_town("Town01")
    for seed in range(_TRIES):
        for approach in list(town.approaches)[seed % 5 :: 5]:
            trial = draw_trial(town, approach, kind, seed)
            try:
                check_fault(trial)
            except NetworkError:
                continue
            yield trial
            break


def telling(kind: FaultKind) -> DrivenEpisode:
    """Return the first drive with a wrong end: unsafe, or by another exit than the route's; else the first."""
    driven = []
    for trial in trials_of(kind):
        driven.append(drive_trial(AGENT, trial))
        outcome = driven[-1].outcome
        assert outcome is not None  # each drive ends with its verdict
        if outcome.unsafe_strict or (outcome.verdict.exited and outcome.exit is not trial.route):
            return driven[-1]
    return driven[0]


def with_strip(frames: Iterator[Image], driven: DrivenEpisode, decisions: list[int]) -> Iterator[Image]:
    """Yield the frames with the commands below them; a line marks the moment."""
    rows = driven.trajectory.rows
    told = [rows[min(2 * decision + 1, len(rows) - 1)] for decision in range(decisions[0], decisions[-1] + 1)]
    for frame, decision in zip(frames, decisions, strict=True):
        width = frame.shape[1]
        strip = np.full((3 * _ROW, width, 3), 255, np.uint8)
        edges = np.linspace(0, width, len(told) + 1).astype(int)
        for row, begin, end in zip(told, edges, edges[1:], strict=False):
            strip[2 : _ROW + 1, begin:end] = _COLOURS[Command(row.command)]
            strip[_ROW + 2 : 2 * _ROW + 1, begin:end] = _COLOURS[Command(row.route_command)]
        here = told[decision - decisions[0]]
        text = f"told: {COMMANDS[Command(here.command)]}   route: {COMMANDS[Command(here.route_command)]}"
        cv2.putText(strip, text, (4, 3 * _ROW - 3), cv2.FONT_HERSHEY_SIMPLEX, 0.38, (20, 20, 20), 1, cv2.LINE_AA)
        at = int(edges[decision - decisions[0]])
        strip[: 2 * _ROW + 2, max(at - 1, 0) : at + 1] = 0
        yield np.concatenate([frame, strip])


def film(kind: FaultKind) -> str:
    """Make the film of a fault, and return its line for the page."""
    driven = telling(kind)
    assert driven.outcome is not None
    replay = Replay(driven.trajectory, driven.outcome, AGENT)
    last = len(replay) - 1
    decisions = [*range(max(0, last - round(10 * _LONGEST_S)), last, _EVERY), last]
    frames = replay.frames(View.BOTH, _SIZE, first=decisions[0], every=_EVERY)
    write_film(FILMS / f"{kind}.webp", with_strip(frames, driven, decisions), rate=_RATE, small=True)
    said = f"Film: {AGENT} in {driven.trial.id}. {words.ended(driven.outcome)}"
    return f"![{said}](pictures/faults/{kind}.webp)"


def main() -> None:
    """Make all films, and put each into its section of the page."""
    FILMS.mkdir(parents=True, exist_ok=True)
    page = PAGE.read_text("utf-8")
    for kind in available_faults():
        if kind is FaultKind.NONE or "disturbances" in fault_class(kind).__module__:
            continue
        line = film(kind)
        page = re.sub(rf"(?m)^!\[[^\n]*\(pictures/faults/{kind}\.webp\)\n\n?", "", page)
        page = page.replace(f"## {kind}\n\n", f"## {kind}\n\n{line}\n\n")
        print(hashlib.sha256((FILMS / f"{kind}.webp").read_bytes()).hexdigest()[:12], line)
    PAGE.write_text(page, "utf-8")


if __name__ == "__main__":
    main()
