import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# The helpers of other tests, and the cluster of the benchmarks, are imported by their plain names.
HELPERS = ("tests/service", "tests/sandbox", "tests/runner", "tests/agents", "tests/agents/training", "benchmarks")
sys.path[:0] = [str(Path(__file__).parents[3] / folder) for folder in HELPERS]

from service_harness import OPERATOR, RunningService, running_service  # noqa: E402
from submission_owner import Owner  # noqa: E402


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    """A service whose simulators are on this machine."""
    with running_service(tmp_path_factory.mktemp("service") / "wrongturn.db", operator_token=OPERATOR) as running:
        yield running


@pytest.fixture
def owner(serving: RunningService) -> Iterator[Owner]:
    """Who hands in models to the service that a file calls ``serving``."""
    owner = Owner(serving.url)
    yield owner
    owner.close()
