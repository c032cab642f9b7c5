"""Where this repository keeps what was driven and trained for its own pages."""

from pathlib import Path
from typing import Final

LAB: Final = Path(__file__).parent / "stored"
"""Learning curves (``curves/``), studies and evaluations (``studies/``)."""
