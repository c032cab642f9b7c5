import sys
from pathlib import Path

import pytest

# The helpers beside these tests are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(autouse=True)
def _plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("WRONGTURN_URL", "WRONGTURN_TOKEN", "WRONGTURN_OWNER_TOKEN", "WRONGTURN_OPERATOR_TOKEN"):
        monkeypatch.delenv(name, raising=False)
