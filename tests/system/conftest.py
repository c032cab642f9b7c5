import importlib.util
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest


def _load(name: str) -> ModuleType:
    # Test folders are no packages (pytest's importlib mode), so what they share is loaded by its path.
    spec = importlib.util.spec_from_file_location(f"system_{name}", Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[f"system_{name}"] = module
    spec.loader.exec_module(module)
    return module


compose_project = _load("compose_project")
_load("bare_environment")


@pytest.fixture(scope="session")
def composed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A service in containers. Its tests leave it running."""
    secrets = tmp_path_factory.mktemp("compose") / "secrets"
    make = Path(__file__).parents[2] / "docker" / "make-secrets"
    subprocess.run([str(make), str(secrets)], check=True, capture_output=True)
    project = compose_project.Service(secrets)
    try:
        project.compose("--profile", "careful", "build")
        project.up()
        yield project
    finally:
        project.compose("--profile", "careful", "down", "--volumes", "--remove-orphans")
