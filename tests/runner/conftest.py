import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from wrongturn_client import LocalService

# The helpers beside these tests are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalService]:
    database = tmp_path_factory.mktemp("service") / "wrongturn.db"
    with LocalService(
        database=f"sqlite+aiosqlite:///{database}", environment={"WRONGTURN_SUBMISSIONS": "0"}
    ) as service:
        yield service
