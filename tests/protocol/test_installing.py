"""Advice on what to install repeats how Wrongturn was installed."""

import json
import re
import subprocess
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


@pytest.mark.parametrize(
    "told", [None, {"url": "https://x/y.whl", "archive_info": {}}, {"url": "file:///no", "dir_info": {}}]
)
def test_elsewhere_a_folder_of_wheels_is_named(monkeypatch: pytest.MonkeyPatch, told: dict[str, Any] | None) -> None:
    come_from(monkeypatch, told)
    wheels = f"{PIP} -c dist/constraints.txt --find-links dist"
    assert installing.install("wrongturn-agents[onnx]") == f"{wheels} 'wrongturn-agents[onnx]'"
    assert installing.install("wrongturn-networks", "wrongturn-service").startswith(f"{wheels} wrongturn-networks ")


def test_packages_of_others_come_from_the_index() -> None:
    assert installing.install("eclipse-sumo==1.24.0") == f"{PIP} eclipse-sumo==1.24.0"


def test_every_advice_has_this_one_home() -> None:
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    parts = re.compile(r"(clients|networks|service|agents|plugins/\w+/wrongturn_\w+)/")
    files = [name for name in listed.split() if parts.match(name) and not name.endswith("/installing.py")]
    assert len(files) > 300
    assert [name for name in files if (ROOT / name).exists() and "pip install" in (ROOT / name).read_text()] == []
