import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# The helpers beside these tests are imported by their plain names, and the laboratory as ``lab``.
sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[2])]

from small_networks import small_networks  # noqa: E402


@pytest.fixture(name="small_networks", scope="module")
def _small_networks() -> Iterator[None]:
    """Build the paper's agents with few channels and one block in each stage."""
    with small_networks():
        yield
