"""A town as the renderer needs it. The ground of its net is made once and kept on the disk."""

import contextlib
import functools
import os
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from wrongturn_networks import Town
from wrongturn_networks.per_net import once_per_net
from wrongturn_protocol.home import home
from wrongturn_sim.camera.ground import CELL, Grid, bare, dressed
from wrongturn_sim.camera.solids import rows_of

FORMAT: Final = 2
"""Version of the cached file, part of its name. Increase it when :func:`~wrongturn_sim.camera.ground.bare` changes."""
KEPT: Final = 200
"""Grounds that are kept on the disk, about 2 GB at most; the oldest unused ones go."""


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
        """Return the world of a town; each process makes it once."""
        return _world_of(town)


@functools.lru_cache(maxsize=16)
def _world_of(town: Town) -> World:
    grid, ground = _bare(town)
    frame = np.array([grid.x, grid.y, 1.0 / CELL])
    return World(dressed(grid, ground, town.scenery), frame, rows_of(town.scenery))


@once_per_net(4)
def _bare(town: Town) -> tuple[Grid, NDArray[np.uint8]]:
    """Return the ground without scenery, from the disk if it was made before."""
    file = home() / "camera" / f"{town.plain.sha256}-{FORMAT}.npz"
    grid = Grid.around(town.bounds)
    try:
        # Opened here, because numpy leaves a broken archive open. Archives have checksums.
        with file.open("rb") as opened, np.load(opened, allow_pickle=False) as kept:
            ground: NDArray[np.uint8] = kept["ground"]
        if ground.shape != (grid.rows, grid.columns):
            raise ValueError
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        _, ground = bare(town)
        _write(file, ground)
    else:
        with contextlib.suppress(OSError):
            file.touch()
    return grid, ground


def _write(file: Path, ground: NDArray[np.uint8]) -> None:
    """Keep the ground in a file. A full or read-only disk is no error: the ground can be made again."""
    with contextlib.suppress(OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=file.parent, suffix=".npz")
        try:
            with os.fdopen(handle, "wb") as opened:
                np.savez(opened, ground=ground)
            Path(name).replace(file)
            for old in sorted(file.parent.glob("*.npz"), key=lambda one: one.stat().st_mtime)[:-KEPT]:
                old.unlink(missing_ok=True)
        except OSError:
            Path(name).unlink(missing_ok=True)
            raise
