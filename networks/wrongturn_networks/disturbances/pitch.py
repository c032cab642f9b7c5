"""Pitch: the camera looks up or down."""

import math
from dataclasses import replace
from typing import Any

from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults.fault import Dose
from wrongturn_protocol import FaultKind


class Pitch(Disturbance):
    """The camera is tilted about its horizontal axis."""

    kind = FaultKind.PITCH
    guide_word = "other than"
    words = "The camera is tilted up or down."
    drawn = "up for an even seed, down for an odd one"
    dose = Dose("the tilt", "°", 0.0, 20.0, 2.0, (1.0, 2.0, 4.0))

    def mounted(self, camera: Any) -> Any:
        """Return the camera with another pitch."""
        return replace(camera, pitch=camera.pitch - math.radians(self.signed))
