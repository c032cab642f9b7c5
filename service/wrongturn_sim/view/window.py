"""What pictures are drawn with: the part of a town that a picture shows, and text."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from wrongturn_sim.view import colours
from wrongturn_sim.view.colours import Colour

Image = NDArray[np.uint8]
"""RGB, uint8 (height, width, 3)."""
Points = NDArray[np.float64]
"""Places in the town's frame, metres, (n, 2)."""

_SHIFT: Final = 4
"""Binary places of a pixel's fraction, for smooth edges and motion."""

_FONT: Final = cv2.FONT_HERSHEY_SIMPLEX
_HEIGHT: Final = 21.0
"""Height of the font's capitals at scale 1, pixels."""

Line = tuple[str, Colour]
"""A line of text and its colour."""


@dataclass(frozen=True)
class Window:
    """A square of a town."""

    x: float
    y: float
    """The middle's place, metres."""
    extent: float
    """The side, metres."""
    size: int
    """The side, pixels."""
    up: float = math.pi / 2
    """The direction that points up, radians in the town's frame; by default north."""

    @cached_property
    def scale(self) -> float:
        """Pixels of a metre."""
        return self.size / self.extent

    def pixels(self, points: Points) -> Points:
        """Return places (n, 2) as pixels from the left and from above."""
        away = turned(np.asarray(points, np.float64) - (self.x, self.y), self.up) * (self.scale, -self.scale)
        return away + (self.size - 1) / 2

    def fill(self, image: Image, rings: list[Points], colour: Colour) -> None:
        """Fill the area between rings; a ring within another one is a hole."""
        cv2.fillPoly(image, [self._fixed(ring) for ring in rings], colour, cv2.LINE_AA, _SHIFT)

    def line(self, image: Image, points: Points, colour: Colour, width: float, *, closed: bool = False) -> None:
        """Draw a line through places; the width is in pixels."""
        thickness = max(1, round(width))
        cv2.polylines(image, [self._fixed(points)], closed, colour, thickness, cv2.LINE_AA, _SHIFT)

    def _fixed(self, points: Points) -> NDArray[np.int32]:
        # Far beyond the picture nothing is seen, and larger numbers would overflow.
        limited = np.clip(self.pixels(points), -1e6, 1e6)
        return np.round(limited * (1 << _SHIFT)).astype(np.int32)


def turned(points: Points, up: float) -> Points:
    """Return places (n, 2) as metres to the right and upwards, where the direction ``up`` (radians) points up."""
    sin, cos = math.sin(up), math.cos(up)
    found: Points = points @ np.array([[sin, cos], [-cos, sin]])
    return found


def box(x: float, y: float, yaw: float, length: float, width: float) -> Points:
    """Return the corners (4, 2) of a body: front left, front right, rear right, rear left."""
    forward = np.array([math.cos(yaw), math.sin(yaw)]) * length / 2
    left = np.array([-math.sin(yaw), math.cos(yaw)]) * width / 2
    middle = np.array([x, y])
    front, rear = middle + forward, middle - forward
    return np.stack([front + left, front - left, rear - left, rear + left])


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
