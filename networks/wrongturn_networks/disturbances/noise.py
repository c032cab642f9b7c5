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
    tracks = (Track.CAMERA, Track.WORDS)

    def developed(self, pictures: Observation, decision: int) -> Observation:
        """Return the pictures with noise in their colours."""
        if not self.amount:
            return pictures
        # A generator of its own for each decision, so that the noise does not depend on what was shown before.
        random = np.random.Generator(np.random.Philox(key=[self.seed, decision]))
        return {
            name: np.clip(
                picture + np.rint(self.amount * random.standard_normal(picture.shape, np.float32)), 0, 255
            ).astype(np.uint8)
            if picture.ndim == 3
            else picture
            for name, picture in pictures.items()
        }
