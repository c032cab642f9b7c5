"""Text on pictures."""

from collections.abc import Sequence
from typing import Final

import cv2
import numpy as np

from wrongturn_sim.view import colours
from wrongturn_sim.view.colours import Colour
from wrongturn_sim.view.window import Image

_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_HEIGHT: Final = 21.0
"""Height of the font's capitals at scale 1, pixels."""

Line = tuple[str, Colour]
"""A line of text and its colour."""


def write(
    image: Image, text: str, place: tuple[float, float], height: float, colour: Colour, *, halo: bool = False
) -> None:
    """Write a line of ASCII text with its lower left corner at a place, in pixels from the left and from above.

    ``height`` is that of the capitals, pixels; ``halo`` puts a light edge round the letters.
    """
    at, scale = (round(place[0]), round(place[1])), height / _HEIGHT
    thin = max(1, round(height / 9))
    if halo:
        cv2.putText(image, text, at, _FONT, scale, colours.PANEL, thin + 4, cv2.LINE_AA)
    cv2.putText(image, text, at, _FONT, scale, colour, thin, cv2.LINE_AA)


def width_of(text: str, height: float) -> int:
    """Return a line's width in pixels."""
    return int(cv2.getTextSize(text, _FONT, height / _HEIGHT, max(1, round(height / 9)))[0][0])


def panel(lines: Sequence[Line], width: int, height: int, letter: float) -> Image:
    """Return a picture (height, width, 3) of lines of text, the first one above.

    A line that is too long gets smaller letters.
    """
    image = np.full((height, width, 3), colours.PANEL, np.uint8)
    for number, (text, colour) in enumerate(lines):
        fitting = letter * min(1.0, (width - 2 * letter) / max(width_of(text, letter), 1))
        write(image, text, (letter, letter * 2.1 * (number + 1)), fitting, colour)
    return image
