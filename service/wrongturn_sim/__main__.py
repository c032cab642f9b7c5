"""Compile all kernels of episodes, as when an image is built: ``python -m wrongturn_sim``.

They are kept where ``NUMBA_CACHE_DIR`` says, so that no process that finds them there has to compile.
"""

from typing import Final

from wrongturn_networks import draw_journey, draw_trial, load_town
from wrongturn_protocol import FaultKind, Task, Track
from wrongturn_sim.episode import Episode
from wrongturn_sim.home import set_cache

_TOWN: Final = "junctions"


def main() -> None:
    """Drive for a moment in both kinds of trial and on every track, and say where the kernels are."""
    town = load_town(_TOWN)
    junction = draw_trial(town, next(iter(town.approaches)), FaultKind.NONE, 0)
    for trial in (junction, draw_journey(town, Task.NAVIGATION, 0)):
        for track in Track:
            episode = Episode(trial, track)
            episode.reset()
            episode.step(0.0, 0.5, 0.0)
            episode.abort()
    print(f"compiled into {set_cache()}")


if __name__ == "__main__":
    main()
