"""Noise: the pixels of the camera's picture are noisy."""

import numpy as np

from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults.fault import Dose
from wrongturn_protocol import FaultKind, Track
from wrongturn_protocol.observations import Observation


class Noise(Disturbance):
    """Each colour of each pixel of ``rgb`` has Gaussian noise, new at each decision."""

    kind = FaultKind.NOISE
    guide_word = "as well as"
    words = "The camera's picture is noisy."
    drawn = "the noise"
    dose = Dose("the standard deviation of each colour's noise", "of 255", 0.0, 100.0, 15.0, (15.0, 30.0))
    tracks = (Track.CAMERA,)

    def sensed(self, observation: Observation, decision: int) -> Observation:
        """Return the observation with a noisy picture."""
        picture = observation.get("rgb")
        if picture is None or not self.amount:
            return observation
        # A generator of its own for each decision, so that the noise does not depend on what was shown before.
        random = np.random.Generator(np.random.Philox(key=[self.seed, decision]))
        noise = np.rint(self.amount * random.standard_normal(picture.shape, np.float32))
        return {**observation, "rgb": np.clip(picture + noise, 0, 255).astype(np.uint8)}
