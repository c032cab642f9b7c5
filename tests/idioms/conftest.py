"""What the idioms share: ids, a folder to write to, and a service for those over the wire."""

import sys
from pathlib import Path

import pytest

from wrongturn_client import LocalService

sys.path.insert(0, str(Path(__file__).parent))  # ids.py is imported by its plain name


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Idioms write beside themselves: models, logs, films."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def over_the_wire(service: LocalService, monkeypatch: pytest.MonkeyPatch) -> None:
    """A service at ``WRONGTURN_URL``."""
    monkeypatch.setenv("WRONGTURN_URL", service.url)
    for name in ("WRONGTURN_TOKEN", "WRONGTURN_OWNER_TOKEN"):
        monkeypatch.delenv(name, raising=False)
