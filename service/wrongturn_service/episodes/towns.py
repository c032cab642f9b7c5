"""The process that builds towns in the background: ``python -m wrongturn_service.episodes.towns``.

It reads a JSON list: a suite's id and a secret, or an empty text and names of towns with spaces between. For a suite it
writes the draw, ``{"trials": [...], "twins": [...]}``. A secret never stands on a command line.
"""

import json
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from typing import Final

from wrongturn_networks import load_suite, load_town
from wrongturn_networks.drawn import build_drawn, forget_unused
from wrongturn_networks.errors import NetworkError
from wrongturn_sim.camera import World

KEPT: Final = 200
"""Towns that are kept, with about 1 MB each; the oldest unused ones go. A name builds its town again."""


def prepare(name: str) -> None:
    """Build a town, and the ground that cameras see."""
    build_drawn(name)
    World.of(load_town(name))


def main() -> int:
    """Do what standard input asks for; the exit status is 1 where a town cannot be built."""
    suite_id, asked = json.load(sys.stdin)
    os.nice(10)
    try:
        names = asked.split() if not suite_id else load_suite(suite_id).drawn_towns(asked)
        with ProcessPoolExecutor(min(len(names), len(os.sched_getaffinity(0)))) as processes:
            list(processes.map(prepare, names))
        forget_unused(KEPT)
        if suite_id:
            draw = load_suite(suite_id).draw(asked)
            told = {"trials": draw.trials, "twins": draw.twins}
            print(json.dumps({name: [trial.model_dump(mode="json") for trial in told[name]] for name in told}))
    except NetworkError as error:
        print(*str(error).split(), file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
