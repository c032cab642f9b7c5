import sys
from pathlib import Path

# The programs of the laboratory, and the helpers of the agents' tests.
ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "agents")]
