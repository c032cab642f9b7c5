import sys
from pathlib import Path

# The helpers beside these tests, and those of the service, are imported by their plain names.
sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "service")]
