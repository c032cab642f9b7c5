"""Traffic of a fleet: simple drivers and pedestrians in the fleet's own kernel, without SUMO.

They look and are hit like SUMO's, and drive much like them. But the same trial meets other road users here than there:
use it for training, not for scores.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from wrongturn_networks import Town
from wrongturn_protocol import Trial
from wrongturn_sim.errors import TrafficTooDenseError
from wrongturn_sim.fleet.others import TRAFFIC, Others, others_for
from wrongturn_sim.fleet.streets import MOST, streets_of

_GOLDEN: Final = 0x9E3779B97F4A7C15
_MASK: Final = 2**64 - 1
_MORE: Final = 16
"""Arrays grow by multiples of this many road users, because the kernel's memory is made anew each time."""


@dataclass(frozen=True)
class FleetTraffic:
    """How the other road users of a fleet behave; by default as much like SUMO's as they can."""

    hesitant: float = 0.0
    """Share of the cars that drive at 30 to 70 % of the speed limit and stop now and then for 1 to 6 seconds without
    need, for training: so a learner often meets a car that brakes.
    """
    leaders: float = 0.0
    """Share of the drives with a car shortly ahead at the start, where the lane has room."""
    crossers: float = 0.0
    """Share of the junctions at which a car from another street crosses the ego's way about when the ego comes, where
    the ego has to give way. The car is taken from out of the ego's sight when the ego is 25 m away.
    """
    waiters: float = 0.0
    """Share of the junctions at which a car stands at a stop line: the ego's own, until 2 to 8 seconds after the ego
    can have come, or that of the street into which the ego's way leads, until the ego has left the junction. The car is
    taken from out of the ego's sight when the ego is 45 m away.
    """

    def __post_init__(self) -> None:
        for name in ("hesitant", "leaders", "crossers", "waiters"):
            share = getattr(self, name)
            if not 0.0 <= share <= 1.0:
                raise ValueError(f"{name}: is {share!r}; give a share from 0 to 1")

    def set(self, others: Others, i: int, trial: Trial) -> None:
        """Set how many road users an ego has, and from which seed they are drawn."""
        for array in others:
            array[i] = 0.0
        traffic = others.traffic[i].view(TRAFFIC)[0]
        traffic.vehicles, traffic.pedestrians = trial.traffic.vehicles, trial.traffic.pedestrians
        traffic.hesitant, traffic.leaders = self.hesitant, self.leaders
        traffic.crossers, traffic.waiters = self.crossers, self.waiters
        traffic.met = traffic.stood = -1
        folded = (trial.seed * _GOLDEN + _GOLDEN) & _MASK
        traffic.random = folded - 2**64 if folded >= 2**63 else folded


def check_density(town: Town, trial: Trial) -> None:
    """Raise TrafficTooDenseError, which names the field, if a town has no room for a trial's road users."""
    streets = streets_of(town)
    asked = (
        ("vehicles", trial.traffic.vehicles, streets.slots),
        ("pedestrians", trial.traffic.pedestrians, streets.doors),
    )
    for field, count, places in asked:
        room = int(MOST * len(places))
        if count > room:
            raise TrafficTooDenseError(
                f"traffic.{field}: {town.name} has room for {room} beside a car of a batch, not for {count}; "
                "ask for fewer"
            )


def with_room(others: Others, trials: Sequence[Trial]) -> Others:
    """Return arrays with room for the road users of these trials too; what is there already stays."""
    vehicles = max((trial.traffic.vehicles for trial in trials), default=0)
    pedestrians = max((trial.traffic.pedestrians for trial in trials), default=0)
    have = others.cars.shape[1], others.walkers.shape[1]
    if vehicles <= have[0] and pedestrians <= have[1]:
        return others
    grown = others_for(
        len(others.traffic),
        *(-(-max(a, b) // _MORE) * _MORE for a, b in zip((vehicles, pedestrians), have, strict=True)),
    )
    for ours, before in zip(grown, others, strict=True):
        part: Any = tuple(slice(0, size) for size in before.shape)
        ours[part] = before
    return grown
