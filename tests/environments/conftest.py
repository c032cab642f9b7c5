import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from wrongturn_client import LocalService

sys.path.insert(0, str(Path(__file__).parent))  # kinds.py is imported by its plain name

from kinds import Environments


@pytest.fixture(scope="session")
def tokens() -> dict[str, str]:
    return {}


@pytest.fixture
def over_the_wire(service: LocalService, tokens: dict[str, str]) -> Iterator[Environments]:
    found = Environments("wrongturn_client:Wrongturn-v0", {"url": service.url}, tokens)
    yield found
    found.close()


@pytest.fixture
def in_process() -> Iterator[Environments]:
    found = Environments("wrongturn_sim:WrongturnSim-v0", {})
    yield found
    found.close()


@pytest.fixture(params=["in_process", "over_the_wire"])
def kind(request: pytest.FixtureRequest) -> Environments:
    found: Environments = request.getfixturevalue(request.param)
    return found
