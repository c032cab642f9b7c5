"""Compile everything that numba compiles and keep it: ``python -m wrongturn_sim``.

Images and tests run it once. The compiled code is kept in the folder ``NUMBA_CACHE_DIR``. A process that finds it there
compiles nothing.
"""

from itertools import product
from typing import Final

import numpy as np

from wrongturn_judge.home import set_cache
from wrongturn_networks import draw_journey, draw_trial, load_town
from wrongturn_protocol import FaultKind, Task, Track
from wrongturn_sim.episode import Episode
from wrongturn_sim.fleet.vector_env import WrongturnVectorEnv

_TOWN: Final = "junctions"


def main() -> None:
    """Drive one step of a junction and of a journey on every track, alone and in a batch; print the cache's folder."""
    town = load_town(_TOWN)
    junction = draw_trial(town, next(iter(town.approaches)), FaultKind.NONE, 0)
    for trial, track in product((junction, draw_journey(town, Task.NAVIGATION, 0)), Track):
        episode = Episode(trial, track)
        episode.reset()
        episode.step(0.0, 0.5, 0.0)
        episode.abort()
        if track is Track.WORDS:  # batches have none
            continue
        batch = WrongturnVectorEnv(1, _TOWN, track)
        batch.reset(options={"trial": trial})
        batch.step(np.array([[0.0, 0.5, 0.0]], np.float32))
        batch.close()
    print(f"compiled into {set_cache()}")


if __name__ == "__main__":
    main()
