import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest


def _load(name: str) -> ModuleType:
    # Test folders are no packages (pytest's importlib mode), so what they share is loaded by its path.
    spec = importlib.util.spec_from_file_location(f"client_{name}", Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[f"client_{name}"] = module
    spec.loader.exec_module(module)
    return module


_load("fake_service")
_load("fake_submissions")
_load("forwarder")


@pytest.fixture(autouse=True)
def _plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("WRONGTURN_URL", "WRONGTURN_TOKEN", "WRONGTURN_OWNER_TOKEN", "WRONGTURN_OPERATOR_TOKEN"):
        monkeypatch.delenv(name, raising=False)
