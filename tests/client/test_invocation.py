"""Commands that the program prints can be pasted."""

import sys
from pathlib import Path

import pytest

from wrongturn_client.invocation import program


@pytest.mark.parametrize(
    ("called", "printed"),
    [
        (".venv/bin/wrongturn", ".venv/bin/wrongturn"),
        ("/with space/wrongturn", "'/with space/wrongturn'"),
        ("/usr/lib/wrongturn_client/__main__.py", "/bin/python -m wrongturn_client"),
        ("-m", "/bin/python -m wrongturn_client"),
    ],
)
def test_the_program_as_it_was_called(called: str, printed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", [called, "run"])
    monkeypatch.setattr(sys, "executable", "/bin/python")
    assert program() == printed


def test_found_by_the_path_its_name_is_enough(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "wrongturn"
    file.touch(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sys, "argv", [str(file)])
    assert program() == "wrongturn"
