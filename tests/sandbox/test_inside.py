"""Hostile Python inside a sandbox reaches nothing: no files, network, processes or privileges.

The same attempts run under bubblewrap alone, under bubblewrap after a guest has confined itself, and in a listener's
guest, where nothing but the confinement holds.
"""

import json
import os
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from wrongturn_sandbox import bubblewrap as bwrap

ATTEMPTS = Path(__file__).with_name("hostile_attempts.py")
FILES = ["/etc/passwd", "/etc/hostname", "/proc/1/environ", "/proc/self/environ", "/dev/mem", "/sys/kernel/notes"]


CONFINED = ["bubblewrap and confined", "a listener's guest"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of the host with a secret in it."""
    made = tmp_path_factory.mktemp("host")
    (made / "secret").write_text("mine")
    return made


@pytest.fixture(scope="module", params=["bubblewrap alone", *CONFINED])
def told(request: pytest.FixtureRequest, folder: Path) -> Any:
    """What hostile Python could do in a sandbox."""
    confined = request.param != "bubblewrap alone"
    given = {"confine": confined, "files": [*FILES, str(folder / "secret"), str(Path.home())], "folder": str(folder)}
    program = ATTEMPTS.read_text(encoding="utf-8")
    if request.param == "a listener's guest":
        return in_a_listener(request.getfixturevalue("start_listener"), program, given)
    request.getfixturevalue("bubblewrap")
    mine, theirs = socket.socketpair()
    with mine, theirs:
        line = bwrap.command(["-c", program, json.dumps({**given, "socket": theirs.fileno()})])
        subprocess.run(line, pass_fds=(theirs.fileno(),), check=True, timeout=300, env={"SECRET": "of the host"})
        theirs.close()
        return heard(mine)


def in_a_listener(start_listener: Any, program: str, given: dict[str, Any]) -> Any:
    wrapper = (
        "import json, sys; given = json.loads(sys.argv[1]); given['socket'] = int(sys.argv[2]); "
        f"sys.argv = ['', json.dumps(given)]; exec({program!r})"
    )
    path = start_listener(command=[sys.executable, "-c", wrapper, json.dumps(given)])
    with socket.socket(socket.AF_UNIX) as mine:
        mine.connect(str(path))
        return heard(mine)


def heard(connection: socket.socket) -> Any:
    with connection.makefile("rb") as lines:
        return json.loads(lines.readline())


def test_no_file_can_be_read(told: Any) -> None:
    read = told["read"]
    assert set(read) >= set(FILES)
    assert [file for file, content in read.items() if content != "no"] == []


def test_no_file_can_be_written(told: Any, folder: Path) -> None:
    assert [place for place, done in told["written"].items() if done != "no"] == []
    assert list(folder.iterdir()) == [folder / "secret"]


def test_no_network(told: Any) -> None:
    assert len(told["sockets"]) == 4
    assert [kind for kind, done in told["sockets"].items() if done != "no"] == []


def test_no_other_process_is_within_reach(told: Any) -> None:
    assert told["processes"] in ("no", [])
    assert told["parent"] == 1 or told["confined"]  # bubblewrap's own process, inside the sandbox too
    if told["confined"]:
        assert told["killed"] == "no"
        assert told["traced"] == "no"
        assert told["memory_of_parent"] == "no"


def test_no_privileges(told: Any) -> None:
    assert told["capabilities"] in ("no", 0) or (os.geteuid() == 0 and told["confined"])
    assert [step for step, done in told["privileges"].items() if done != "no"] == []


def test_no_secret_of_the_host_is_inherited(told: Any) -> None:
    assert "SECRET" not in told["environment"]
    assert "HOME" not in told["environment"]
    assert told["descriptors"] == 4  # the three of any process, and the socket


@pytest.mark.parametrize("told", CONFINED, indirect=True)
def test_a_confined_guest_starts_nothing(told: Any) -> None:
    assert told["fork"] == "no"
    assert told["exec"] == "no"
    assert told["thread"] == "no"
    assert told["old_thread"] == "no"  # one that a library may have started before
    assert told["code"] == "no"
    assert told["open_own"] == "no"
