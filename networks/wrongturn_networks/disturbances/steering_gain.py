"""Steering gain: the wheels turn more or less than they should."""

from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults.fault import Dose
from wrongturn_protocol import FaultKind, Track


class SteeringGain(Disturbance):
    """The wheels turn more or less than the agent steers, up to their limit. The observation has their angle."""

    kind = FaultKind.STEERING_GAIN
    guide_word = "more, less"
    words = "The wheels turn more or less than the agent steers."
    drawn = "more for an even seed, less for an odd one"
    dose = Dose("the difference", "%", 0.0, 90.0, 20.0, (20.0, 40.0))
    tracks = tuple(Track)

    def steered(self, steer: float) -> float:
        """Return the steering times the gain, within -1 and 1."""
        return min(max(steer * (1.0 + self.signed / 100.0), -1.0), 1.0)
