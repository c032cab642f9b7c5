import sys
from pathlib import Path

# The agents' helpers, which make runs, and the laboratory are imported by their plain names.
ROOT = Path(__file__).parents[3]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "agents")]
