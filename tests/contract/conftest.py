import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

# The helpers beside these tests, and those of the service's, are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parents[1] / "service"))
sys.path.insert(0, str(Path(__file__).parent))

from example_story import OPERATOR
from service_harness import RunningService, running_service


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    """A service that tests share."""
    settings = {"operator_token": OPERATOR, "submissions": 1, "registration_limit": 100_000, "simulators": 2}
    with running_service(tmp_path_factory.mktemp("contract") / "wrongturn.db", **settings) as running:
        yield running


@pytest.fixture(scope="session")
def document(service: RunningService) -> dict[str, Any]:
    """The OpenAPI document."""
    found = httpx.get(f"{service.url}/openapi.json", timeout=60).json()
    assert isinstance(found, dict)
    return found
