"""What the idioms share: ids, a folder to write to, and one service for those over the wire."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from wrongturn_client import LocalService

sys.path.insert(0, str(Path(__file__).parent))  # ids.py is imported by its plain name


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Idioms write beside themselves: models, logs, films."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="session")
def _service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalService]:
    database = tmp_path_factory.mktemp("service") / "wrongturn.db"
    settings = {"WRONGTURN_SIMULATORS": "2", "WRONGTURN_SUBMISSIONS": "0"}
    with LocalService(database=f"sqlite+aiosqlite:///{database}", environment=settings) as service:
        yield service


@pytest.fixture
def over_the_wire(_service: LocalService, monkeypatch: pytest.MonkeyPatch) -> None:
    """A service with two simulators, at ``WRONGTURN_URL``."""
    monkeypatch.setenv("WRONGTURN_URL", _service.url)
    for name in ("WRONGTURN_TOKEN", "WRONGTURN_OWNER_TOKEN"):
        monkeypatch.delenv(name, raising=False)
