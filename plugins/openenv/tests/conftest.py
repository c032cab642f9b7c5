import sys
from pathlib import Path

import pytest

# The client's stand-in for a service is imported by its plain name.
sys.path.insert(0, str(Path(__file__).parents[3] / "tests/client"))


@pytest.fixture(autouse=True)
def _plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("WRONGTURN_URL", "WRONGTURN_TOKEN", "WRONGTURN_OWNER_TOKEN", "WRONGTURN_OPERATOR_TOKEN"):
        monkeypatch.delenv(name, raising=False)
