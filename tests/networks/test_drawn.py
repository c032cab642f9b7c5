"""Drawn towns: a name is enough to build one, the same for everyone, and nobody sees a half of one."""

import importlib.util
import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from wrongturn_networks import TownBuildError, UnknownTownError, bends_of, drawn, load_town, town_names
from wrongturn_networks.drawn import build_drawn, build_towns, drawn_name, is_built, is_drawn
from wrongturn_networks.making import netconvert
from wrongturn_networks.making.checking import flaws
from wrongturn_protocol import PAPER_TYPES

NAME = "drawn-00000000000000ff"
SHA256 = "9dca246a06c0f7aef0847484536357a479fd6c498fbfe051b0b7b51810e51438"
"""Checksum of that town. If it changes, increase ``drawn.VERSION``."""


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A data folder of the test's own, with no towns in it."""
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path))
    return tmp_path


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_name_holds_the_first_8_bytes_of_a_seed() -> None:
    assert drawn_name(bytes(7) + b"\xff") == drawn_name(bytes(7) + b"\xffmore") == NAME
    assert is_drawn(NAME)
    with pytest.raises(ValueError, match="seed: has 7 bytes"):
        drawn_name(bytes(7))


@pytest.mark.parametrize("name", ["Town01", "generated-1", NAME + "\n", NAME.upper(), NAME + "0", "drawn-", None, 1])
def test_other_names_are_not_drawn(name: Any, home: Path) -> None:
    assert not is_drawn(name)
    assert not is_built(name)
    with pytest.raises(UnknownTownError, match=r"^town: "):
        build_drawn(name)
    assert list(home.iterdir()) == []


def test_a_town_is_built_once_by_all_who_want_it(home: Path) -> None:
    assert not is_built(NAME)
    with ThreadPoolExecutor() as pool:  # each in processes of its own
        list(pool.map(lambda _: build_towns([NAME, NAME]), range(2)))
    assert is_built(NAME)
    assert [path.name for path in (home / "towns").iterdir()] == [NAME]
    town = load_town(NAME)
    assert load_town(NAME) is town
    assert town.sha256 == SHA256
    assert NAME not in town_names()
    assert list(flaws(town)) == []
    widths = {lane.width for lane in town.lanes.values()}
    assert len(widths) == len(town.lanes) / 2
    assert all(3.5 <= width <= 4.25 for width in widths)
    assert all(bends_of(lane) for lane in town.lanes.values())


def test_a_folder_that_is_unlike_what_the_name_makes_is_replaced(home: Path) -> None:
    folder = home / "towns" / NAME
    (folder / "half").mkdir(parents=True)
    whole = bytes_of(build_drawn(NAME))
    # By another version of SUMO, or of the generator.
    for other in ({"sumo": "1.27.0"}, {"generator": 0}):
        (folder / "manifest.json").write_text(json.dumps(json.loads(whole["manifest.json"]) | other))
        assert not is_built(NAME)
        assert bytes_of(build_drawn(NAME)) == whole
    # A part is lost.
    (folder / "scenery.toml").write_text("")
    assert load_town(NAME).scenery
    assert bytes_of(folder) == whole


def test_what_keeps_a_town_from_being_built_is_said(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(drawn, "SUMO", "1.0.0")
        with pytest.raises(TownBuildError, match=r"^town: .*; .*pip install eclipse-sumo==1.0.0"):
            build_drawn(NAME)
    with monkeypatch.context() as patch:
        patch.setattr(importlib.util, "find_spec", lambda _: None)
        netconvert.version.cache_clear()
        with pytest.raises(TownBuildError, match=r"^town: .*netconvert is missing; .*pip install eclipse-sumo"):
            build_drawn(NAME)
    shutil.rmtree(home)
    home.write_text("a file")
    with pytest.raises(TownBuildError, match=r"^town: .*let WRONGTURN_HOME name a folder"):
        build_towns([NAME])


def test_towns_that_would_not_do_are_found_out() -> None:
    short = [flaw for flaw in flaws(load_town("Town01")) if flaw.endswith(" m")]
    assert "J8-J11_1: 27.6 m" in short
    few = [flaw for flaw in flaws(load_town("junctions")) if "approaches" in flaw]
    assert few == [f"1 approaches of type {kind}" for kind in PAPER_TYPES]
    assert "some lane cannot be reached from another" in flaws(load_town("junctions"))


def test_the_version_of_sumo_is_the_one_that_is_installed() -> None:
    assert netconvert.version() == drawn.SUMO
