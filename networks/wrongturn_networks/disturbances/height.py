"""Height: the camera is mounted higher or lower."""

from dataclasses import replace
from typing import Any

from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults.fault import Dose
from wrongturn_protocol import FaultKind


class Height(Disturbance):
    """The camera is mounted at another height."""

    kind = FaultKind.HEIGHT
    guide_word = "more, less"
    words = "The camera is mounted too high or too low."
    drawn = "higher for an even seed, lower for an odd one"
    dose = Dose("the difference", "m", 0.0, 1.0, 0.3, (0.3, 0.6))

    def mounted(self, camera: Any) -> Any:
        """Return the camera at another height."""
        return replace(camera, up=camera.up + self.signed)
