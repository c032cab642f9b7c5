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

from wrongturn_judge.home import home
from wrongturn_networks import Town
from wrongturn_sim.camera.ground import CELL, bake
from wrongturn_sim.camera.solids import rows_of

FORMAT: Final = 1
"""Version of the cached file, part of its name. Increase it when :func:`~wrongturn_sim.camera.ground.bake` changes."""

_KNOWN: dict[str, "World"] = {}


@dataclass(frozen=True, eq=False)
class World:
    """Ground and scenery of a town. The arrays are read-only."""

    name: str
    sha256: str
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
        known = _KNOWN.get(town.sha256)
        if known is None:
            known = _KNOWN[town.sha256] = cls._loaded(town)
        return known

    @classmethod
    def _loaded(cls, town: Town) -> "World":
        file = home() / "camera" / f"{town.sha256}-{FORMAT}.npz"
        kept = _read(file)
        if kept is None:
            made, raster = bake(town)
            kept = (np.array([made.x, made.y, 1.0 / CELL]), raster)
            _write(file, *kept)
        frame, ground = kept
        scenery = rows_of(town.scenery)
        return cls(town.name, town.sha256, ground, frame, scenery)


def _read(file: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8]] | None:
    """Return the ground's frame and raster from a file; None if the file is missing or broken."""
    try:
        # Opened here, because numpy leaves a broken archive open.
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as kept:
            frame, ground, checksum = kept["frame"], kept["ground"], int(kept["checksum"])
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None
    fits = frame.dtype == np.float64 and frame.shape == (3,) and ground.dtype == np.uint8 and ground.ndim == 2
    return (frame, ground) if fits and checksum == _checksum(ground) else None


def _checksum(ground: NDArray[np.uint8]) -> int:
    return int(np.bitwise_xor.reduce(ground, axis=None)) << 40 | int(ground.sum(dtype=np.int64))


def _write(file: Path, frame: NDArray[np.float64], ground: NDArray[np.uint8]) -> None:
    """Keep the ground in a file. A full or read-only disk is no error: the ground can be made again."""
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=file.parent, suffix=".npz")
        try:
            with os.fdopen(handle, "wb") as opened:
                np.savez(opened, frame=frame, ground=ground, checksum=_checksum(ground))
            Path(name).replace(file)
        except OSError:
            Path(name).unlink(missing_ok=True)
            raise
