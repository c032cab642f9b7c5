"""Films of trials as the camera sees them: what an agent does when the command is wrong.

::

    python -m wrongturn_agents.training.export.film AGENT FILE [TRIAL ...] [--suite SUITE] [--unsafe RESULTS]

A FILE that ends in ``.webp`` becomes a film, one that ends in ``.png`` a sheet: a row a trial, moments from left to
right.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wrongturn_agents.agent import Agent, track_of_agent
from wrongturn_agents.errors import AgentsError
from wrongturn_agents.registry import resolve
from wrongturn_agents.reporting.results_file import ResultsFile
from wrongturn_agents.suites import WRONG_COMMAND
from wrongturn_agents.training.errors import TrainingError
from wrongturn_networks import NetworkError, load_suite, load_town
from wrongturn_protocol import Command, Outcome, Trial
from wrongturn_protocol.observations import observation_space
from wrongturn_sim import Episode
from wrongturn_sim.camera import Renderer, World

Image = NDArray[np.uint8]

MOMENTS: Final = 8
"""Of a trial, on a sheet."""
_SCALE: Final = 2
_CAPTION: Final = 14
"""Pixels of the line above a picture."""
_DECISION: Final = 0.1
"""Seconds between two pictures."""
_LAST: Final = 1200
"""Milliseconds for which a film stays at a trial's end."""


@dataclass(frozen=True)
class Filmed:
    """One trial, picture by picture."""

    trial: Trial
    outcome: Outcome
    pictures: tuple[Image, ...]
    """RGB with a caption above: time, command, speed."""


def film_trial(agent: Agent, trial: Trial) -> Filmed:
    """Drive a trial in this process, and keep what the camera sees; what the agent is shown is its track's."""
    track = track_of_agent(agent)
    assert track is not None  # the registry makes no agent without
    episode = Episode(trial, track)
    observation = episode.reset()
    agent.reset(observation_space(track))
    renderer = Renderer(World.of(load_town(trial.town)), weather=trial.weather, seed=trial.seed)
    pictures: list[Image] = []
    while True:
        row = episode.trajectory.rows[-1]
        rgb = observation["rgb"] if "rgb" in observation else renderer.render(row.x, row.y, row.yaw)[0]
        command = Command(int(np.asarray(observation["command"]).item())).name
        said = f"{_DECISION * len(pictures):4.1f} s  {command}  {row.v:.1f} m/s"
        if episode.outcome is not None:
            said += f"  {episode.outcome.verdict}"
        pictures.append(_captioned(rgb, said))
        if episode.outcome is not None:
            return Filmed(trial, episode.outcome, tuple(pictures))
        action = agent.act(observation)
        observation = episode.step(action.steer, action.throttle, action.brake).observation


def sheet(filmed: Sequence[Filmed]) -> Image:
    """A row a trial; moments evenly from its start to its end."""
    rows = []
    for one in filmed:
        moments = np.linspace(0, len(one.pictures) - 1, MOMENTS).round().astype(int)
        pictures = np.concatenate([one.pictures[moment] for moment in moments], axis=1)
        title = f"{one.trial.id}  {one.trial.junction_type}  {one.outcome.verdict}"
        if one.outcome.reaction is not None:
            title += f"  {one.outcome.reaction}"
        rows.append(np.concatenate([_line(title, pictures.shape[1]), pictures]))
    return np.concatenate(rows)


def unsafe_trials(results: Path) -> tuple[Trial, ...]:
    """Return the trials of a results file that are unsafe in the strict column, twins too.

    Raises:
        ResultsError: the file cannot be read, or does not fit its suite.
    """
    file = ResultsFile.read(results)
    file.check(results.name)
    return tuple(file.drawn.trials[name] for name, one in sorted(file.trials.items()) if one.unsafe_strict)


def write(file: Path, filmed: Sequence[Filmed]) -> None:
    """Write a film or a sheet.

    Raises:
        TrainingError: the file's name ends otherwise, or it cannot be written.
    """
    if file.suffix == ".png":
        written = cv2.imwrite(str(file), sheet(filmed)[:, :, ::-1])
    elif file.suffix == ".webp":
        animation = cv2.Animation()
        frames = [picture for one in filmed for picture in one.pictures]
        each = round(1000 * _DECISION)
        animation.frames = [np.ascontiguousarray(frame[:, :, ::-1]) for frame in frames]
        animation.durations = [time for one in filmed for time in (*(each,) * (len(one.pictures) - 1), _LAST)]
        written = cv2.imwriteanimation(str(file), animation, [cv2.IMWRITE_WEBP_QUALITY, 55])
    else:
        raise TrainingError(f"FILE: {file.name} is neither film nor sheet; give a name that ends in .webp or .png")
    if not written:
        raise TrainingError(f"FILE: {file} cannot be written; name one in a directory that exists")


def _captioned(rgb: Image, said: str) -> Image:
    picture = np.asarray(rgb, np.uint8).repeat(_SCALE, axis=0).repeat(_SCALE, axis=1)
    return np.concatenate([_line(said, picture.shape[1]), picture])


def _line(said: str, width: int) -> Image:
    line = np.zeros((_CAPTION, width, 3), np.uint8)
    cv2.putText(line, said, (3, _CAPTION - 4), cv2.FONT_HERSHEY_SIMPLEX, 0.38, (255, 255, 255), 1, cv2.LINE_AA)
    return line


def main(arguments: Sequence[str] | None = None) -> int:
    """Make a film or a sheet; gives the status."""
    parser = argparse.ArgumentParser(prog="python -m wrongturn_agents.training.export.film", description=__doc__)
    parser.add_argument("agent", help="a registered name, package.module:Class, or an .onnx file")
    parser.add_argument("file", type=Path, help=".webp for a film, .png for a sheet")
    parser.add_argument("trials", nargs="*", metavar="TRIAL", help="ids; all of the suite by default")
    parser.add_argument("--suite", default=WRONG_COMMAND)
    parser.add_argument("--unsafe", type=Path, metavar="RESULTS", help="the unsafe trials of a results file")
    options = parser.parse_args(arguments)
    try:
        agent = resolve(options.agent).make()
        suite = load_suite(options.suite)
        named = [suite.trial(name) for name in options.trials]
        trials = [*named, *(unsafe_trials(options.unsafe) if options.unsafe else ())] or list(suite.trials)
        filmed = []
        for trial in trials:
            filmed.append(film_trial(agent, trial))
            print(trial.id, filmed[-1].outcome.verdict, filmed[-1].outcome.reaction or "")
        write(options.file, filmed)
    except (AgentsError, NetworkError) as error:
        print(error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
