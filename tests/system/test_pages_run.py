"""The files and commands that README and the tutorial show work from the first to the last."""

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from wrongturn_client import LocalService

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text("utf-8")
TUTORIAL = (ROOT / "docs/tutorial.md").read_text("utf-8")
INSTALLING = (ROOT / "docs/installing.md").read_text("utf-8")
SERVE = "wrongturn serve"
SERVED_AT = "http://127.0.0.1:8000"


def section(page: str, title: str) -> str:
    return page.split(f"\n## {title}\n")[1].split("\n## ", maxsplit=1)[0]


def files(text: str) -> dict[str, str]:
    return dict(re.findall(r'```python title="(\w+\.py)"\n(.*?)```', text, re.DOTALL))


def commands(text: str) -> list[str]:
    blocks = re.findall(r"```sh\n(.*?)```", text, re.DOTALL)
    return [line.removeprefix(".venv/bin/") for block in blocks for line in block.splitlines()]


def extras_of(part: Path) -> set[str]:
    return {*tomllib.loads((part / "pyproject.toml").read_text("utf-8"))["project"].get("optional-dependencies", {})}


def run(command: str, folder: Path) -> str:
    program, *arguments = command.split()
    start = {"python": [sys.executable], "wrongturn": [sys.executable, "-m", "wrongturn_client"]}[program]
    ignored = {"WRONGTURN_URL", "WRONGTURN_TOKEN", "WRONGTURN_OWNER_TOKEN"}
    environment = {name: value for name, value in os.environ.items() if name not in ignored}
    if arguments[0] == "submit":
        environment["WRONGTURN_HOME"] = str(folder / "home")  # keeps the owner's token
    done = subprocess.run(
        [*start, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command}\n{done.stdout[-1000:]}\n{done.stderr[-3000:]}"
    return done.stdout


def begin(text: str, folder: Path, url: str | None = None) -> str:
    """Write the files, run the commands before the service, with the URL of one if given; return the last output."""
    for name, content in files(text).items():
        (folder / name).write_text(content, "utf-8")
    shown = commands(text)
    before = [f"{one} --url {url}" if url and " run " in one else one for one in shown[: shown.index(SERVE)]]
    return [run(command, folder) for command in before][-1]


def follow(text: str, folder: Path, service: LocalService, name: str) -> tuple[str, dict[str, object]]:
    """Run the commands that need the service; return the last output and the agent's entry on the leaderboard."""
    shown = commands(text)
    for command in shown[shown.index(SERVE) + 1 :]:
        assert SERVED_AT in command
        last = run(command.replace(SERVED_AT, service.url), folder)
    entries = json.loads(run(f"wrongturn leaderboard smoke@3 --url {service.url} --json", folder))["entries"]
    (entry,) = (entry for entry in entries if entry["agent"]["name"].startswith(name))
    return last, entry


@pytest.mark.parametrize(
    "text", [section(README, "Install"), section(TUTORIAL, "1. Install")], ids=["README", "tutorial"]
)
def test_what_is_installed_exists(text: str) -> None:
    parts = re.findall(r"-e '?(\w+)(?:\[([\w,]+)\])?'?", text)
    assert [part for part, _ in parts] == ["clients", "networks", "service", "agents"]
    for part, extras in parts:
        assert set(filter(None, extras.split(","))) <= extras_of(ROOT / part)


def test_the_extras_that_the_pages_install_are_those_of_wrongturn() -> None:
    shown = re.findall(r"wrongturn\[([\w,]+)\]", TUTORIAL + INSTALLING)
    assert {extra for extras in shown for extra in extras.split(",")} == extras_of(ROOT)


@pytest.mark.timeout(900)
def test_the_readmes_environment_runs(tmp_path: Path) -> None:
    (snippet,) = re.findall(r"```python\n(.*?)```", section(README, "Install"), re.DOTALL)
    (tmp_path / "snippet.py").write_text(snippet, "utf-8")
    assert run("python snippet.py", tmp_path).startswith("(64, 192, 3) [")


@pytest.mark.system
@pytest.mark.timeout(900)
def test_the_readmes_agent_comes_to_the_leaderboard(tmp_path: Path, service: LocalService) -> None:
    text = section(README, "Your own agent")
    assert [command.split()[:2] for command in commands(text)] == [
        ["wrongturn", "run"],
        ["wrongturn", "serve"],
        ["wrongturn", "run"],
        ["wrongturn", "leaderboard"],
    ]
    (tmp_path / "my_agents.py").write_text(files(text)["my_agents.py"], "utf-8")
    # The first command is the third with a service of its own, as tests/extending has one.
    first, _, third, _ = commands(text)
    assert third == f"{first} --url {SERVED_AT}"
    shown, entry = follow(text, tmp_path, service, "Slow")
    assert "Slow" in shown
    assert entry["unsafe"]["trials"] == 6


@pytest.mark.soak
@pytest.mark.system
@pytest.mark.timeout(900)
def test_the_tutorials_agent_is_trained_exported_and_driven(tmp_path: Path, service: LocalService) -> None:
    """A few steps do for that. Only those that the page shows suffice to drive."""
    text = TUTORIAL.split("\n## 2. ")[1]
    assert text.count("model.learn(80_000)") == 1
    assert "left or" in begin(text.replace("80_000", "2_048"), tmp_path, service.url)


@pytest.mark.soak
@pytest.mark.system
@pytest.mark.timeout(1200)
@pytest.mark.usefixtures("bubblewrap")
def test_the_tutorials_agent_comes_to_the_leaderboard(tmp_path: Path) -> None:
    """The shorter run follows the page up to the service, and hands models in as the page on submitting does."""
    text = TUTORIAL.split("\n## 2. ")[1]
    assert [command.split()[:2] for command in commands(text)] == [
        ["python", "train.py"],
        ["wrongturn", "export"],
        ["wrongturn", "run"],
        ["wrongturn", "serve"],
        ["wrongturn", "submit"],
    ]
    begin(text, tmp_path)
    with LocalService(database=f"sqlite+aiosqlite:///{tmp_path}/wrongturn.db") as alone:
        shown, entry = follow(text, tmp_path, alone, "first-driver")
    assert re.search(r"^(Rank 1 of 1 in the privileged track|Not ranked: )", shown, re.MULTILINE), shown
    assert (entry["entry"], entry["agent"]["name"], entry["agent"]["track"]) == (
        "uploaded",
        "first-driver",
        "privileged",
    )
    assert entry["unsafe"]["trials"] == 6
    # A network that has not learned completes none of the six.
    assert entry["twins"]["completed"] >= 1
