import sys
from pathlib import Path

# The laboratory, whose simulations these tests repeat, is imported by its plain name.
sys.path.insert(0, str(Path(__file__).parents[3]))
