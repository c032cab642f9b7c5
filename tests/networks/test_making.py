"""Building towns again gives what is committed, and a town that was tampered with is found out."""

import shutil
from pathlib import Path

import pytest

from wrongturn_networks import CorruptFileError, Town, load_town, read_town, town_names
from wrongturn_networks.loading import TOWNS
from wrongturn_networks.making import build
from wrongturn_networks.making.recipes import RECIPES


@pytest.mark.parametrize("name", town_names())  # each has a recipe
def test_a_town_built_again_is_the_same_bytes(name: str, tmp_path: Path) -> None:
    build(RECIPES[name], tmp_path / name)
    made = {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()}
    assert made == {path.name: path.read_bytes() for path in (TOWNS / name).iterdir()}


def test_nothing_of_the_machine_is_in_the_files(town: Town) -> None:
    for path in town.directory.iterdir():
        text = path.read_text("utf-8")
        assert "/tmp/" not in text
        assert "<!--" not in text


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A town's folder that may be spoilt."""
    return Path(shutil.copytree(TOWNS / "junctions", tmp_path / "junctions"))


@pytest.mark.parametrize("file", ["junctions.net.xml", "scenery.toml", "manifest.json"])
def test_a_file_that_is_missing(copied: Path, file: str) -> None:
    (copied / file).unlink()
    with pytest.raises(CorruptFileError, match=r"junctions|scenery"):
        read_town(copied)


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [("junctions.net.xml", 'width="4.00"', 'width="5.00"'), ("scenery.toml", "solid = true", "solid = false")],
)
def test_a_file_that_was_changed(copied: Path, file: str, old: str, new: str) -> None:
    path = copied / file
    assert read_town(copied).sha256 == load_town("junctions").sha256
    path.write_text(path.read_text("utf-8").replace(old, new), "utf-8")
    with pytest.raises(CorruptFileError, match="does not match its manifest"):
        read_town(copied)


@pytest.mark.parametrize(
    ("file", "text"), [("junctions.net.xml", "<net"), *(("manifest.json", text) for text in ("", "[]", "{}", "null"))]
)
def test_a_file_that_is_no_such_file(copied: Path, file: str, text: str) -> None:
    (copied / file).write_text(text, "utf-8")
    with pytest.raises(CorruptFileError, match=r"^town junctions: .*; install its package again"):
        read_town(copied)
