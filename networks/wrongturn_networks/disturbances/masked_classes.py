"""Masked classes: the segmentation lacks some of its classes."""

import random

import numpy as np

from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults.fault import Dose
from wrongturn_protocol import FaultKind, SegmentationClass, Track, Trial
from wrongturn_protocol.observations import Observation

_CLASSES = [one for one in SegmentationClass if one not in {SegmentationClass.VOID, SegmentationClass.ROAD}]


class MaskedClasses(Disturbance):
    """Pixels of some classes, the same throughout the drive, have the class VOID. The road is never one of them."""

    kind = FaultKind.MASKED_CLASSES
    guide_word = "part of"
    words = "The segmentation lacks some classes."
    drawn = "which"
    dose = Dose("how many classes", "", 0.0, float(len(_CLASSES)), 3.0, (1.0, 3.0, 6.0))
    tracks = (Track.SEGMENTATION,)

    def __init__(self, trial: Trial) -> None:
        super().__init__(trial)
        order = random.Random(f"classes {self.seed}").sample(_CLASSES, len(_CLASSES))
        self._shown = np.arange(len(SegmentationClass), dtype=np.uint8)
        self._shown[order[: round(self.amount)]] = SegmentationClass.VOID

    def developed(self, pictures: Observation, decision: int) -> Observation:  # noqa: ARG002
        """Return the pictures without these classes."""
        return {name: self._shown[picture] if picture.ndim == 2 else picture for name, picture in pictures.items()}
