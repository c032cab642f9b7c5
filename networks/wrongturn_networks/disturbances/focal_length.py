"""Focal length: the camera's field of view is wider or narrower."""

from dataclasses import replace
from typing import Any

from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults.fault import Dose
from wrongturn_protocol import FaultKind


class FocalLength(Disturbance):
    """The camera has another focal length, with as many pixels."""

    kind = FaultKind.FOCAL_LENGTH
    guide_word = "more, less"
    words = "The camera's focal length is too long or too short."
    drawn = "longer for an even seed, shorter for an odd one"
    dose = Dose("the difference", "%", 0.0, 50.0, 15.0, (10.0, 20.0))

    def mounted(self, camera: Any) -> Any:
        """Return the camera with another focal length."""
        return replace(camera, focal=camera.focal * (1.0 + self.signed / 100.0))
