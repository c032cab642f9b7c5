"""Pictures as portable pixmaps (PPM, P6): a line of sizes, then the bytes. They need no library on either side."""

import re
from typing import Final

import numpy as np
from numpy.typing import NDArray

PIXMAP: Final = "image/x-portable-pixmap"
"""Media type."""
_HEAD: Final = re.compile(rb"P6\n([1-9][0-9]{0,4}) ([1-9][0-9]{0,4})\n255\n")


def to_pixmap(image: NDArray[np.uint8]) -> bytes:
    """Return a picture, RGB uint8 (height, width, 3), as a pixmap."""
    return b"P6\n%d %d\n255\n" % (image.shape[1], image.shape[0]) + image.tobytes()


def from_pixmap(content: bytes) -> NDArray[np.uint8]:
    """Return the picture in a pixmap, RGB uint8 (height, width, 3), writable; raise ValueError if it is none."""
    head = _HEAD.match(content)
    if head is None or len(content) - head.end() != int(head[1]) * int(head[2]) * 3:
        raise ValueError("not a binary portable pixmap of three bytes a pixel")
    return np.frombuffer(content, np.uint8, offset=head.end()).reshape(int(head[2]), int(head[1]), 3).copy()
