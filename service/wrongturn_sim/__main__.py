"""Compile everything that numba compiles and keep it: ``python -m wrongturn_sim``.

Images and tests run it once. The compiled code is kept in the folder ``NUMBA_CACHE_DIR``. A process that finds it there
compiles nothing.
"""

from typing import Final

import numpy as np

from wrongturn_judge.home import set_cache
from wrongturn_networks import draw_journey, draw_trial, load_town
from wrongturn_protocol import FaultKind, Task, Track, Trial
from wrongturn_sim.episode import Episode
from wrongturn_sim.fleet.vector_env import WrongturnVectorEnv

_TOWN: Final = "junctions"


def main() -> None:
    """Drive one step of a junction and of a journey on every track, alone and in a batch; print the cache's folder."""
    town = load_town(_TOWN)
    junction = draw_trial(town, next(iter(town.approaches)), FaultKind.NONE, 0)
    for trial in (junction, draw_journey(town, Task.NAVIGATION, 0)):
        for track in Track:
            _episode(trial, track)
            _batch(trial, track)
    print(f"compiled into {set_cache()}")


def _episode(trial: Trial, track: Track) -> None:
    """Drive one step as the service and the single environment do."""
    episode = Episode(trial, track)
    episode.reset()
    episode.step(0.0, 0.5, 0.0)
    episode.abort()


def _batch(trial: Trial, track: Track) -> None:
    """Drive one step as training does, without SUMO."""
    batch = WrongturnVectorEnv(1, _TOWN, track)
    batch.reset(options={"trial": trial})
    batch.step(np.array([[0.0, 0.5, 0.0]], np.float32))
    batch.close()


if __name__ == "__main__":
    main()
