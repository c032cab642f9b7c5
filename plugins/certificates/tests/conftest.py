import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# The service's helpers are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parents[3] / "tests" / "service"))

from service_harness import RunningService, running_service


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    with running_service(tmp_path_factory.mktemp("service") / "wrongturn.db") as running:
        yield running
