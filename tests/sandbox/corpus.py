"""Uploads that are hostile or broken, made by code. Each is refused or stopped, and its owner is told why.

Import :data:`CORPUS` for tests of a sandbox, of a runner, or of the service over HTTP. The models have the input
``speed`` and the outputs ``steer`` and ``accelerate``, and say that their track is the camera's. So what is wrong with
each is one thing alone.
"""

from corpus_bombs import BOMBS
from corpus_contract import CONTRACT
from corpus_files import FILES
from corpus_graphs import GRAPHS
from corpus_operators import OPERATORS
from upload_models import By, Case

__all__ = ["CORPUS", "By", "Case"]

CORPUS: tuple[Case, ...] = (*FILES, *GRAPHS, *OPERATORS, *BOMBS, *CONTRACT)
"""All uploads."""
