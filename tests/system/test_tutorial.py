"""docs/tutorial.md works from its first file to the leaderboard."""

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
PAGE = (ROOT / "docs/tutorial.md").read_text("utf-8")
INSTALL, BEYOND = PAGE.split("\n## 1. Install\n")[1].split("\n## 2. ")
FILES = dict(re.findall(r'```python title="(\w+\.py)"\n(.*?)```', BEYOND, re.DOTALL))
COMMANDS = [line for block in re.findall(r"```sh\n(.*?)```", BEYOND, re.DOTALL) for line in block.splitlines()]
SERVED_AT = "http://127.0.0.1:8000"


def test_the_extras_that_it_installs_exist() -> None:
    extras = re.findall(r"(\w+)\[([\w,]+)\]", INSTALL)
    assert extras
    for part, names in extras:
        project = tomllib.loads((ROOT / part / "pyproject.toml").read_text("utf-8"))["project"]
        assert set(names.split(",")) <= project["optional-dependencies"].keys()


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_its_files_and_commands_lead_to_the_leaderboard(tmp_path: Path) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, "utf-8")
    ignored = {"WRONGTURN_URL", "WRONGTURN_TOKEN"}
    environment = {name: value for name, value in os.environ.items() if name not in ignored}

    def run(command: str) -> str:
        program, *arguments = command.split()
        start = [sys.executable] if program == "python" else [sys.executable, "-m", "wrongturn_client"]
        assert program in {"python", "wrongturn"}
        done = subprocess.run(
            [*start, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, f"{command}\n{done.stdout[-1000:]}\n{done.stderr[-3000:]}"
        return done.stdout

    before, after = COMMANDS[: COMMANDS.index("wrongturn serve")], COMMANDS[COMMANDS.index("wrongturn serve") + 1 :]
    assert [command.split()[:2] for command in before] == [
        ["python", "train.py"],
        ["python", "export.py"],
        ["wrongturn", "run"],
    ]
    for command in before:
        run(command)
    with LocalService(database=f"sqlite+aiosqlite:///{tmp_path}/wrongturn.db") as service:
        shown = [run(command.replace(SERVED_AT, service.url)) for command in after]
        ranking = json.loads(run(f"wrongturn leaderboard smoke@1 --url {service.url} --json"))
    assert "first-driver" in shown[-1]
    (entry,) = ranking["entries"]
    assert entry["agent"]["track"] == "privileged"
    assert entry["unsafe"]["trials"] == 6
    # It drives: no twin of an untrained network comes to its exit.
    assert entry["twins"]["completed"] >= 1
