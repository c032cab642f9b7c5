"""Delay: the agent sees what was some time ago."""

from collections import deque

from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults.fault import Dose
from wrongturn_protocol import FaultKind, Track, Trial
from wrongturn_protocol.observations import NAVIGATION, Observation


class Delay(Disturbance):
    """All that an observation holds comes late, but for what the planner tells; to the nearest decision.

    Until then it is what the first one held.
    """

    kind = FaultKind.DELAY
    guide_word = "late"
    words = "What the agent sees comes late. Its command does not."
    dose = Dose("how much too late it comes", "s", 0.0, 2.0, 0.3, (0.2, 0.5))
    tracks = tuple(Track)

    def __init__(self, trial: Trial) -> None:
        super().__init__(trial)
        self._past: deque[Observation] = deque()

    def sensed(self, observation: Observation, decision: int) -> Observation:  # noqa: ARG002
        """Return the older observation with today's command, as new arrays."""
        self._past.append({name: value.copy() for name, value in observation.items()})
        if len(self._past) > round(self.amount * self.rate) + 1:
            self._past.popleft()
        told = {name: value for name, value in observation.items() if name in NAVIGATION}
        return {name: value.copy() for name, value in self._past[0].items()} | told
