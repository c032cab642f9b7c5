"""A town as the renderer needs it, made once and kept on the disk."""

import contextlib
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Town
from wrongturn_protocol.home import home
from wrongturn_sim.camera.ground import CELL, bake
from wrongturn_sim.camera.solids import rows_of

FORMAT: Final = 1
"""Version of the cached file, part of its name. Increase it when :func:`~wrongturn_sim.camera.ground.bake` changes."""

_KNOWN: dict[str, "World"] = {}


@dataclass(frozen=True, eq=False)
class World:
    """Ground and scenery of a town. The arrays are read-only."""

    ground: NDArray[np.uint8]
    """(rows, columns), from south to north and from west to east; see :mod:`~wrongturn_sim.camera.ground`."""
    frame: NDArray[np.float64]
    """(3,): x and y of the corner of the ground's first cell, metres, and the number of cells in a metre."""
    scenery: NDArray[np.float64]
    """(N, COLUMNS); see :mod:`~wrongturn_sim.camera.solids`."""

    def __post_init__(self) -> None:
        for array in (self.ground, self.frame, self.scenery):
            array.flags.writeable = False

    @classmethod
    def of(cls, town: Town) -> "World":
        """Return the world of a town: from this process or from the disk if it was made before."""
        if town.sha256 not in _KNOWN:
            _KNOWN[town.sha256] = cls._loaded(town)
        return _KNOWN[town.sha256]

    @classmethod
    def _loaded(cls, town: Town) -> "World":
        file = home() / "camera" / f"{town.sha256}-{FORMAT}.npz"
        try:
            # Opened here, because numpy leaves a broken archive open. Archives have checksums.
            with file.open("rb") as opened, np.load(opened, allow_pickle=False) as kept:
                frame, ground = kept["frame"], kept["ground"]
        except (OSError, ValueError, KeyError, EOFError, BadZipFile):
            made, ground = bake(town)
            frame = np.array([made.x, made.y, 1.0 / CELL])
            _write(file, frame, ground)
        return cls(ground, frame, rows_of(town.scenery))


def _write(file: Path, frame: NDArray[np.float64], ground: NDArray[np.uint8]) -> None:
    """Keep the ground in a file. A full or read-only disk is no error: the ground can be made again."""
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=file.parent, suffix=".npz")
        try:
            with os.fdopen(handle, "wb") as opened:
                np.savez(opened, frame=frame, ground=ground)
            Path(name).replace(file)
        except OSError:
            Path(name).unlink(missing_ok=True)
            raise
