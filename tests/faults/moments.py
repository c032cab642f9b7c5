"""Which process is killed when: drawn from a seed alone, so that a run can be repeated."""

import random
from dataclasses import dataclass

SERVICE, SIMULATOR, CLIENT, POSTGRES = "service", "simulator", "client", "PostgreSQL"
ALL = (SERVICE, SIMULATOR, CLIENT, POSTGRES)
NO_SERVER = (SERVICE, SIMULATOR, CLIENT)
"""Where the database is a file."""
WEIGHTS = {SERVICE: 2, SIMULATOR: 4, CLIENT: 3, POSTGRES: 2}
_OFTEN_S, _AT_ONCE_S = (0.1, 2.5), (0.0, 0.3)


@dataclass(frozen=True)
class Moment:
    """One kill.

    Attributes:
        victim: one of the kinds above.
        at_once: whether it comes upon the kill before, and so may hit what is just being started again; else it waits
            until the service is ready and somebody drives.
        pause_s: seconds since then.
        at_write: whether it waits for the next write to the database after the pause, to come between it and its reply.
        pick: which of the victim's kind, from 0 to 1.
        back_s: seconds until somebody starts a killed client again.
    """

    victim: str
    at_once: bool
    pause_s: float
    at_write: bool
    pick: float
    back_s: float


def moments(seed: int, count: int, victims: tuple[str, ...]) -> list[Moment]:
    """A list of kills. Each kind of victim is among the first ones, so that a short list has all of them."""
    chance = random.Random(seed)
    kinds = chance.sample(victims, len(victims))
    kinds += chance.choices(victims, [WEIGHTS[victim] for victim in victims], k=max(0, count - len(kinds)))
    drawn = []
    for victim in kinds[:count]:
        at_once = chance.random() < 1 / 6
        pause_s = chance.uniform(*(_AT_ONCE_S if at_once else _OFTEN_S))
        at_write = victim != SIMULATOR and chance.random() < 0.5
        drawn.append(Moment(victim, at_once, pause_s, at_write, chance.random(), chance.uniform(0.0, 4.0)))
    return drawn
