"""Verdicts and flags by the numbers that the kernels use."""

from typing import Final

from wrongturn_protocol import Flag, Verdict
from wrongturn_sim.verdict import decide

VERDICTS: Final = (None, *Verdict)
"""Verdict by its number; 0 is none."""
FLAGS: Final = {
    decide.KERB_BITE: Flag.KERB_BITE,
    decide.LANE_INVASION: Flag.LANE_INVASION,
    decide.WRONG_WAY_FLAG: Flag.WRONG_WAY,
    decide.OVER_LINE: Flag.OVER_LINE,
}
"""Flag by its bit."""
