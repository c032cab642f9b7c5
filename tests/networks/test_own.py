"""Towns and suites of the user's own: by name from WRONGTURN_HOME, by path, and never in place of a shipped one."""

import json
import re
import shutil
from pathlib import Path

import gymnasium
import pytest
from typer.testing import CliRunner, Result

from wrongturn_client.cli import app
from wrongturn_networks import (
    NetworkError,
    UnknownTownError,
    load_suite,
    load_town,
    loading,
    suite_ids,
    suites,
    town_names,
)
from wrongturn_networks.loading import TOWNS, town_named
from wrongturn_networks.suites import suite_named

NET = TOWNS / "Town01" / "Town01.net.xml"


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home without towns and suites."""
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "home"))
    for variable in ("WRONGTURN_TOWNS", "WRONGTURN_SUITES"):
        monkeypatch.setenv(variable, "")
    return tmp_path / "home"


def wrongturn(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(one) for one in arguments])


def imported(*arguments: object, name: str) -> Result:
    result = wrongturn("towns", "import", NET, "--name", name, *arguments)
    assert result.exit_code == 0, result.output
    return result


def test_what_lies_at_home_has_a_name_everywhere(home: Path) -> None:
    imported(name="home-town")
    assert "home-town" in town_names()
    assert wrongturn("towns", "home-town").output.count("left or right") == 12
    assert wrongturn("towns", "check", home / "towns" / "home-town").exit_code == 0
    made = wrongturn("suite", "make", "--town", "home-town", "--name", "own@1", "--cells", "late=8@LEFT_RIGHT*3")
    assert made.exit_code == 0, made.output
    assert "own@1" in suite_ids()
    suite = load_suite("own@1")
    assert suite.counts == (3, 3)
    assert {trial.town for trial in suite.trials} == {"home-town"}
    listed = json.loads(wrongturn("trials", "own@1", "--secret", "any", "--json").output)
    assert [trial["fault"]["dose"] for trial in listed["trials"]] == [8.0] * 3


def test_paths_stand_for_names(tmp_path: Path, home: Path) -> None:
    imported("--to", tmp_path, name="path-town")
    assert "path-town" not in town_names()
    with pytest.raises(UnknownTownError):
        load_town(str(tmp_path / "path-town"))  # a stranger may have sent it
    env = gymnasium.make("wrongturn_sim:WrongturnSim-v0", town=str(tmp_path / "path-town"), track="state")
    env.reset(seed=1)
    env.close()
    assert "path-town" in town_names()
    assert not (home / "towns").exists()
    made = wrongturn("suites", "make", "--town", tmp_path / "path-town", "--name", "path@1", "--to", tmp_path)
    assert made.exit_code == 0, made.output
    assert wrongturn("trials", tmp_path / "path@1.json").exit_code == 0
    assert suite_named(str(tmp_path / "path@1.json")) == "path@1"


def test_a_suite_keeps_to_the_town_that_it_was_made_for(home: Path) -> None:
    imported(name="changing")
    assert wrongturn("suites", "make", "--town", "changing", "--name", "kept@1").exit_code == 0
    shutil.rmtree(home / "towns" / "changing")
    imported("--seed", "2", name="changing")
    loading.shelf.cache_clear()  # another process reads them anew
    suites.shelf.cache_clear()
    assert "kept@1" not in suite_ids()
    with pytest.raises(NetworkError, match="changing is not the one that the suite was made for"):
        load_suite("kept@1")


def test_broken_ones_are_left_out_and_named_when_asked_for(home: Path) -> None:
    folder = home / "towns" / "broken"
    folder.mkdir(parents=True)
    (folder / "manifest.json").write_text("{}", "utf-8")
    assert "broken" not in town_names()
    with pytest.raises(NetworkError, match="broken"):
        load_town("broken")
    checked = wrongturn("towns", "check", folder)
    assert checked.exit_code == 1
    assert "broken.net.xml is missing" in checked.output


def test_a_shipped_name_is_never_taken(tmp_path: Path) -> None:
    folder = shutil.copytree(TOWNS / "Town02", tmp_path / "Town02")
    with pytest.raises(NetworkError, match="there is another Town02"):
        town_named(str(folder))
    assert load_town("Town02").directory == TOWNS / "Town02"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("towns", "import", "missing.osm"), "there is no such file"),
        (("towns", "import", NET, "--name", "1"), "--name"),
        (("towns", "import", NET, "--left-hand"), "--left-hand"),
        (("towns", "import", NET, "--name", "a", "--option=--nonsense"), "netconvert rejects it"),
        (("suites", "make", "--town", "Town99", "--name", "a@1"), "did you mean|not known"),
        (("suites", "make", "--town", "Town01", "--name", "a"), "no suite's id"),
        (("suites", "make", "--town", "Town01", "--name", "smoke@3"), "suites never change"),
        (("suites", "make", "--town", "Town01", "--name", "a@1", "--cells", "late=x"), "is no cell"),
        (("suites", "make", "--town", "Town01", "--name", "a@1", "--cells", "lat"), "is no fault"),
        (("suites", "make", "--town", "Town01", "--name", "a@1", "--cells", "late=900"), "dose"),
        (("suites", "make", "--town", "Town01", "--name", "a@1", "--cells", "late@CROSS"), "suits them"),
    ],
)
def test_mistakes_are_named(arguments: tuple[object, ...], said: str) -> None:
    result = wrongturn(*arguments)
    assert result.exit_code != 0
    assert re.search(said, result.output + str(result.exception)), (result.output, result.exception)
