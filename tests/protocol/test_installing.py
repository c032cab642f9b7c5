"""Advice on what to install repeats how Wrongturn was installed."""

import json
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from wrongturn_protocol import installing

ROOT = Path(__file__).parents[2]
PIP = f"{sys.executable} -m pip install"


def come_from(monkeypatch: pytest.MonkeyPatch, told: dict[str, Any] | None, missing: tuple[str, ...] = ()) -> None:
    """Let the client's metadata tell this origin, and let these parts not be installed."""

    class Found:
        def read_text(self, name: str) -> str | None:
            return None if told is None else json.dumps(told)

    def from_name(name: str) -> Found:
        if name in missing:
            raise metadata.PackageNotFoundError(name)
        return Found()

    monkeypatch.setattr(installing.Distribution, "from_name", from_name)


@pytest.mark.parametrize(("editable", "flag"), [(True, "-e "), (False, "")])
def test_a_clone_is_installed_from_its_folders(monkeypatch: pytest.MonkeyPatch, editable: bool, flag: str) -> None:
    missing = ("wrongturn-sb3",)
    come_from(monkeypatch, {"url": (ROOT / "clients").as_uri(), "dir_info": {"editable": editable}}, missing)
    clone = f"{PIP} -c {ROOT}/constraints.txt"
    assert installing.install("wrongturn-figures") == f"{clone} {flag}{ROOT}/plugins/figures"
    # Extras name parts that no index has; each comes once.
    said = installing.install("wrongturn-agents[training]")
    assert said == f"{clone} {flag}'{ROOT}/agents[training]' {flag}{ROOT}/plugins/sb3"


@pytest.mark.parametrize("told", [None, {"url": "https://x/y.whl", "archive_info": {}}])
def test_elsewhere_a_folder_of_wheels_is_named(monkeypatch: pytest.MonkeyPatch, told: dict[str, Any] | None) -> None:
    come_from(monkeypatch, told)
    wheels = f"{PIP} -c dist/constraints.txt --find-links dist"
    assert installing.install("wrongturn-agents[onnx]") == f"{wheels} 'wrongturn-agents[onnx]'"
    # Packages of others come from the index.
    assert installing.install("eclipse-sumo==1.24.0") == f"{PIP} eclipse-sumo==1.24.0"


def test_every_advice_has_this_one_home() -> None:
    parts = ("clients", "networks", "service", "agents", "plugins")
    files = [
        file for part in parts for file in (ROOT / part).glob("**/wrongturn_*/**/*.py") if "build" not in file.parts
    ]
    found = [file.name for file in files if "pip install" in file.read_text(encoding="utf-8")]
    assert found == ["installing.py"]
