import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from wrongturn_client import Client

# The helpers beside these tests are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parent))

from client_fake_service import FakeService


@pytest.fixture(autouse=True)
def _plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("WRONGTURN_URL", "WRONGTURN_TOKEN", "WRONGTURN_OWNER_TOKEN", "WRONGTURN_OPERATOR_TOKEN"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture
def fake() -> FakeService:
    return FakeService()


@pytest.fixture
def client(fake: FakeService) -> Iterator[Client]:
    """A client of the service in memory, without a token."""
    with Client("http://fake", transport=fake.transport) as client:
        yield client
