import sys
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

# The helpers beside these tests are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parent))
# Uploads and models of other tests.
sys.path += [str(Path(__file__).parents[1] / folder) for folder in ("sandbox", "runner")]

from postgres_server import PostgresServer, running_server
from service_harness import OPERATOR, Agent, RunningService, running_service
from submission_owner import Owner


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    """A service that tests share; whoever breaks one starts one of their own."""
    database = tmp_path_factory.mktemp("service") / "wrongturn.db"
    with running_service(database, operator_token=OPERATOR, registration_limit=1000, simulators=6) as running:
        yield running


@pytest.fixture
def http(service: RunningService) -> Iterator[httpx.Client]:
    """A client without a token."""
    with httpx.Client(base_url=service.url, timeout=60) as http:
        yield http


@pytest.fixture
def agent(service: RunningService) -> Iterator[Agent]:
    with service.agent() as agent:
        yield agent


@pytest.fixture
def seeing(service: RunningService) -> Iterator[Agent]:
    """An agent whose observations are large."""
    with service.agent("segmentation") as agent:
        yield agent


@pytest.fixture
def other(service: RunningService) -> Iterator[Agent]:
    with service.agent() as agent:
        yield agent


@pytest.fixture
def owner(serving: RunningService) -> Iterator[Owner]:
    """Who hands in models to the service that a file calls ``serving``."""
    owner = Owner(serving.url)
    yield owner
    owner.close()


@pytest.fixture(scope="session")
def postgres() -> Iterator[PostgresServer]:
    """A PostgreSQL server that tests share; each takes a database of its own."""
    with running_server() as server:
        yield server


@pytest.fixture
def sqlite_url(tmp_path: Path) -> str:
    """The URL of a database that is not there yet."""
    return f"sqlite+aiosqlite:///{tmp_path / 'a.db'}"


@pytest.fixture(params=["sqlite", "postgresql"])
def database_url(request: pytest.FixtureRequest, sqlite_url: str) -> str:
    """The URL of a database that is not there yet, or is empty, of each engine in turn: for what may differ."""
    if request.param == "sqlite":
        return sqlite_url
    server: PostgresServer = request.getfixturevalue("postgres")
    return server.new_database()
