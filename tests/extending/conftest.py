"""Packages made from the text of docs/extending.md, installed for one test."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from wrongturn_networks import faults, loading, suites

PAGE = (Path(__file__).parents[2] / "docs" / "extending.md").read_text("utf-8")
# The service's helpers are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parents[1] / "service"))


def write_files(section: str, folder: Path) -> list[Path]:
    """Write the files of a section of the page, each by the name before it, and return them."""
    text = PAGE.split(f"\n## {section}\n")[1].split("\n## ")[0]
    files = []
    for block in re.finditer(r"```python\n(.*?)```", text, re.DOTALL):
        file = folder / re.findall(r"`([\w/]+\.py)`", text[: block.start()])[-1]
        file.parent.mkdir(exist_ok=True)
        file.write_text(block[1])
        files.append(file)
    return files


def write_points(section: str, folder: Path, more: str = "") -> None:
    """Write what an installer notes of a package: its name and the entry points that the section shows."""
    text = PAGE.split(f"\n## {section}\n")[1].split("\n## ")[0]
    ((group, points),) = re.findall(r"```toml\n\[project\.entry-points\.\"(.*?)\"\]\n(.*?)```", text, re.DOTALL)
    name = f"their_{group.rpartition('.')[2]}"
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{group}]\n{points.replace(chr(34), '')}broken = gone:THING\n{more}")


@pytest.fixture(scope="session")
def town_and_suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's town and suite as packages, made by its programs, each beside entry points that cannot be used."""
    folder = tmp_path_factory.mktemp("site")
    for section, more in (
        ("A town", "again = village_town:VILLAGE\nmissing = village_town:Path\n"),
        ("A suite", "changed = rainy_suite:CHANGED\n"),
    ):
        program, module = write_files(section, folder)
        command = [sys.executable, program]
        subprocess.run(command, cwd=folder, env={**os.environ, "PYTHONPATH": str(folder)}, check=True)
        write_points(section, folder, more)
    module.write_text(f"{module.read_text()}CHANGED = RAINY.with_name('changed@1.json')\n")
    rainy = module.with_name("rainy@1.json").read_text()
    module.with_name("changed@1.json").write_text(rainy.replace('"rainy"', '"changed"'))
    return folder


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """Return a function that installs the packages in a folder for the test."""

    def put(folder: Path) -> None:
        for path in folder.iterdir():
            monkeypatch.delitem(sys.modules, path.stem, raising=False)  # an earlier test's
        monkeypatch.syspath_prepend(folder)
        for module, name in ((faults, "_registry"), (loading, "shelf"), (suites, "shelf")):
            monkeypatch.setattr(module, name, cache(getattr(module, name).__wrapped__))

    return put


@pytest.fixture
def install_page(install: Callable[[Path], None], tmp_path: Path) -> Callable[..., Path]:
    """Return a function that installs a section's package, beside an entry point that cannot be loaded."""

    def put(section: str, more: str = "") -> Path:
        write_files(section, tmp_path)
        write_points(section, tmp_path, more)
        install(tmp_path)
        return tmp_path

    return put
