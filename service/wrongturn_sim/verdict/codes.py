"""The vocabulary's words for what the kernels count."""

from typing import Final

from wrongturn_protocol import Flag, Verdict
from wrongturn_sim.verdict import decide

VERDICTS: Final = (None, *Verdict)
"""By the kernels' number."""
FLAGS: Final = {
    decide.KERB_BITE: Flag.KERB_BITE,
    decide.LANE_INVASION: Flag.LANE_INVASION,
    decide.WRONG_WAY_FLAG: Flag.WRONG_WAY,
    decide.OVER_LINE: Flag.OVER_LINE,
}
"""By their bit."""
