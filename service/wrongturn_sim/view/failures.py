"""Make the documentation's pictures of failures from the file of ``wrongturn run --json``.

::

    python -m wrongturn_sim.view.failures RUN [DIRECTORY]

Each picture is of the moment of the verdict. Nothing is driven again.
"""

import json
import sys
from collections import defaultdict
from itertools import zip_longest
from pathlib import Path
from typing import Final

import cv2

from wrongturn_protocol.run_file import DrivenEpisode, RunFile
from wrongturn_sim.replay import Replay

NUMBER: Final = 10
SIZE: Final = 400
"""Side of the view from above, pixels."""
QUALITY: Final = 80


def failures(run: RunFile, number: int = NUMBER) -> tuple[Replay, ...]:
    """Return replays of episodes that are unsafe in the strict column, as different as there are.

    Junction types, faults and verdicts take turns. Of episodes that are alike, the first by trial comes first.
    """
    groups: dict[tuple[str, str, str], list[Replay]] = defaultdict(list)
    for episode in sorted(run.episodes, key=lambda episode: episode.trial):
        if episode.outcome.verdict.unsafe_strict and episode.trajectory is not None:
            replay = _replay(episode)
            trial = replay.trajectory.trial
            groups[trial.junction_type, trial.fault.kind, episode.outcome.verdict].append(replay)
    in_turn = zip_longest(*(groups[key] for key in sorted(groups)))
    return tuple(replay for turn in in_turn for replay in turn if replay is not None)[:number]


def _replay(episode: DrivenEpisode) -> Replay:
    return Replay.from_json(json.dumps(episode.trajectory), episode.outcome)


def main(run: Path, directory: Path) -> None:
    """Write ``01.webp`` and so on, and print what each shows."""
    directory.mkdir(parents=True, exist_ok=True)
    for number, replay in enumerate(failures(RunFile.read(run)), 1):
        image = replay.both(len(replay) - 1, SIZE)
        file = directory / f"{number:02}.webp"
        cv2.imwrite(str(file), image[:, :, ::-1], [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
        assert replay.outcome is not None
        print(f"{file}: {replay.trajectory.trial.id}, {replay.outcome.verdict}, {replay.outcome.reaction}")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]) if len(sys.argv) > 2 else Path("docs/pictures/failures"))
