"""Noise that is the same on every machine: hashes of whole numbers, without a generator's state."""

import functools

import numpy as np
from numpy.typing import NDArray


def _hash(x: NDArray[np.uint64], y: NDArray[np.uint64], seed: int) -> NDArray[np.uint64]:
    mask = np.uint64(0xFFFFFFFF)
    value = (x * np.uint64(374761393) + y * np.uint64(668265263) + np.uint64(seed * 2246822519 % 2**32)) & mask
    value = ((value ^ (value >> np.uint64(15))) * np.uint64(0x2C1B3C6D)) & mask
    value = ((value ^ (value >> np.uint64(12))) * np.uint64(0x297A2D39)) & mask
    return value ^ (value >> np.uint64(15))


@functools.lru_cache(maxsize=16)
def tile(size: int, grains: tuple[int, ...], seed: int) -> NDArray[np.uint8]:
    """Return a square of noise (size, size), 0 to 255, that repeats without a seam; read-only.

    ``grains`` is the width of each lattice, in cells. The noise is their sum; those named first weigh more.
    """
    total = np.zeros((size, size), np.int64)
    weights = 0
    for octave, grain in enumerate(grains):
        count = size // grain
        index = np.arange(count, dtype=np.uint64)
        lattice = (_hash(index[None, :], index[:, None], seed + octave) & np.uint64(255)).astype(np.int64)
        if grain > 1:
            lattice = _wider(_wider(lattice, grain).T, grain).T
        weight = 1 << (len(grains) - 1 - octave)
        total += lattice * weight
        weights += weight
    made = (total // weights).astype(np.uint8)
    made.flags.writeable = False
    return made


def _wider(lattice: NDArray[np.int64], grain: int) -> NDArray[np.int64]:
    """Widen each column to ``grain`` columns, with a smooth step between neighbours; the last is next to the first."""
    size = lattice.shape[1] * grain
    position = np.arange(size)
    step = (position % grain) * 256 // grain
    step = step * step * (3 * 256 - 2 * step) // 65536
    left = lattice[:, position // grain]
    right = lattice[:, (position // grain + 1) % lattice.shape[1]]
    wider: NDArray[np.int64] = (left * (256 - step) + right * step) // 256
    return wider


@functools.cache
def clouds() -> NDArray[np.uint8]:
    """Return the cover of the sky by clouds: (512, 512), 0 to 255, read-only; fine enough to read the nearest cell."""
    made = tile(512, (128, 64, 32, 16), 3).astype(np.int64)
    low, high = int(made.min()), int(made.max())
    spread = ((made - low) * 255 // (high - low)).astype(np.uint8)
    spread.flags.writeable = False
    return spread
