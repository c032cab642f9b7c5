import sys
from pathlib import Path

# The helpers beside these tests are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parent))
# Small models, and what they come to when nothing disturbs them.
sys.path.insert(1, str(Path(__file__).parents[1] / "runner"))
