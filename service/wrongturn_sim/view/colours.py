"""Colours of drawings, RGB. The pages' light colours are the same."""

from typing import Final

import cv2
import numpy as np

from wrongturn_protocol import Safety

Colour = tuple[int, int, int]

GROUND: Final[Colour] = (238, 240, 236)
SIDEWALK: Final[Colour] = (247, 247, 245)
ROAD: Final[Colour] = (205, 211, 217)
JUNCTION: Final[Colour] = (188, 196, 205)
EDGE: Final[Colour] = (154, 165, 177)
BUILDING: Final[Colour] = (222, 213, 200)
PLANT: Final[Colour] = (196, 214, 188)
STOP_LINE: Final[Colour] = (255, 255, 255)
TEXT: Final[Colour] = (27, 36, 48)
FAINT: Final[Colour] = (85, 96, 110)
PANEL: Final[Colour] = (255, 255, 255)
LINE: Final[Colour] = (207, 213, 221)
BOARD: Final[Colour] = (196, 44, 36)
VEHICLE: Final[Colour] = (120, 104, 150)
PEDESTRIAN: Final[Colour] = (30, 120, 96)
CAR: Final[Colour] = (27, 36, 48)
GLASS: Final[Colour] = (190, 215, 235)
OF_SAFETY: Final[dict[Safety, Colour]] = {
    Safety.SAFE: (31, 111, 178),
    Safety.UNSAFE: (184, 67, 11),
    Safety.NEITHER: (95, 104, 115),
}

_BRIGHTEST: Final = 0.92
"""Share of the scale that is used: its last yellows are too pale on a light ground."""


_STEPS: Final = np.linspace(0, 255 * _BRIGHTEST, 256).astype(np.uint8)
SPEEDS: Final = np.asarray(cv2.applyColorMap(_STEPS[:, None], cv2.COLORMAP_PLASMA)[:, 0, ::-1], np.uint8)
"""(256, 3): colours from standing to the fastest."""


def of_speed(speed: float, fastest: float) -> Colour:
    """Return the colour of a speed between 0 and the fastest, m/s."""
    red, green, blue = SPEEDS[int(255 * min(max(speed / fastest, 0.0), 1.0))].tolist()
    return red, green, blue
