import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

# The helpers beside these tests are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parent))

from system_compose_project import Service


@pytest.fixture(scope="session")
def composed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A service in containers. Its tests leave it running."""
    secrets = tmp_path_factory.mktemp("compose") / "secrets"
    make = Path(__file__).parents[2] / "docker" / "make-secrets"
    subprocess.run([str(make), str(secrets)], check=True, capture_output=True)
    project = Service(secrets)
    try:
        project.compose("--profile", "careful", "build")
        project.up()
        yield project
    finally:
        project.compose("--profile", "careful", "down", "--volumes", "--remove-orphans")
