import sys
from pathlib import Path

# The helpers beside these tests are imported by their plain names, and the laboratory as ``lab``.
sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]
