"""Whether submissions can be driven: looked for at the start, and again when that may have changed."""

import asyncio
import math
import threading
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
import structlog

import wrongturn_sandbox
from wrongturn_protocol import ProblemType
from wrongturn_sandbox import SandboxUnavailableError
from wrongturn_service.cli import checks
from wrongturn_service.errors import UnavailableError
from wrongturn_service.settings import Settings
from wrongturn_service.submissions import availability as module
from wrongturn_service.submissions.availability import Availability

MISSING = "there is no bubblewrap; install it: apt-get install bubblewrap"


class Machine:
    """A machine whose sandboxes come and go."""

    def __init__(self, found: str | None = None) -> None:
        self.found = found
        self.looks = 0

    def __call__(self) -> str:
        self.looks += 1
        if self.found is None:
            raise SandboxUnavailableError(MISSING)
        return self.found


def on(machine: Machine, **settings: Any) -> Availability:
    return Availability(Settings(submissions=settings.pop("submissions", 1), **settings), machine)


async def refusal(availability: Availability) -> str:
    with pytest.raises(UnavailableError) as raised:
        await availability.check()
    assert raised.value.kind is ProblemType.SUBMISSIONS_UNAVAILABLE
    assert raised.value.status == 503
    return raised.value.detail


@pytest.fixture
def aged(monkeypatch: pytest.MonkeyPatch) -> None:
    """A look is out of date at once."""
    monkeypatch.setattr(module, "_FRESH_S", 0.0)
    monkeypatch.setattr(module, "LOOK_S", 0.0)


async def test_sandboxes_are_named_and_the_log_says_so_once() -> None:
    machine = Machine("bubblewrap 0.8.0")
    availability = on(machine)

    with structlog.testing.capture_logs() as lines:
        assert await availability.look()
        assert await availability.look()
        await availability.check()
    assert str(availability) == "on: bubblewrap 0.8.0"
    assert [line["event"] for line in lines] == ["submissions on: bubblewrap 0.8.0"]


async def test_without_sandboxes_the_refusal_says_what_to_do() -> None:
    availability = on(Machine())
    with structlog.testing.capture_logs() as lines:
        assert MISSING in await refusal(availability)
    assert str(availability) == f"off: {MISSING}"
    assert [(line["event"], line["log_level"]) for line in lines] == [(f"submissions off: {MISSING}", "warning")]


@pytest.mark.usefixtures("aged")
async def test_a_container_that_comes_up_later_is_found_when_a_submission_arrives() -> None:
    machine = Machine()
    availability = on(machine, runner_socket=Path("/run/runner/socket"))
    assert MISSING in await refusal(availability)
    machine.found = "runner container"
    await availability.check()
    assert availability.on


async def test_strangers_cannot_make_it_look_all_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_FRESH_S", math.inf)
    machine = Machine()
    availability = on(machine)
    for _ in range(20):
        await refusal(availability)
    assert machine.looks == 1


@pytest.mark.usefixtures("aged")
async def test_a_container_that_goes_is_noticed_and_bubblewrap_is_not_asked_again() -> None:
    machine = Machine("runner container")
    remote, local = on(machine, runner_socket=Path("/run/runner/socket")), on(Machine("bubblewrap 0.8.0"))

    for availability in (remote, local):
        await availability.look_if_due()
        assert availability.on
    machine.found = None
    for availability in (remote, local):
        await availability.look_if_due()
    assert not remote.on
    assert local.on


async def test_turned_off_nobody_looks() -> None:
    machine = Machine("bubblewrap 0.8.0")
    availability = on(machine, submissions=0)
    assert not await availability.look()
    assert "WRONGTURN_SUBMISSIONS" in await refusal(availability)
    assert machine.looks == 0


async def test_a_look_that_hangs_is_given_up_and_no_other_begins_beside_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_PATIENCE_S", 0.05)
    begun, answer = threading.Event(), threading.Event()
    looks = []

    def hang() -> str:
        looks.append(1)
        begun.set()
        assert answer.wait(60)
        return "bubblewrap 0.8.0"

    availability = Availability(Settings(submissions=1), hang)

    assert not await availability.look()
    assert "did not answer" in str(availability)
    assert not await availability.look()
    assert await asyncio.to_thread(begun.wait, 60)
    assert len(looks) == 1
    answer.set()
    while not await availability.look():  # noqa: ASYNC110 - its thread has to end first
        await asyncio.sleep(0.01)
    assert str(availability) == "on: bubblewrap 0.8.0"


def check_of_submissions() -> tuple[str, bool, str, str]:
    with patch("wrongturn_service.simulators.check.examine", return_value="one is enough"):
        (found,) = [check for check in checks() if check[0] == "submissions"]
    return found


def test_the_doctor_names_the_sandbox_or_what_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("WRONGTURN_DATABASE", f"sqlite+aiosqlite:///{tmp_path / 'a.db'}")
    monkeypatch.setenv("WRONGTURN_SUBMISSIONS", "1")
    monkeypatch.setenv("WRONGTURN_RUNNER_SOCKET", str(tmp_path / "no.socket"))
    _, ok, finding, remedy = check_of_submissions()
    assert not ok
    assert str(tmp_path / "no.socket") in finding
    assert "WRONGTURN_SUBMISSIONS=0" in remedy
    monkeypatch.setattr(wrongturn_sandbox, "probe", lambda path: "bubblewrap 0.8.0")
    told = "on: bubblewrap 0.8.0; 4 sandboxes, each model may take 2048 MiB"
    assert check_of_submissions() == ("submissions", True, told, "")
    monkeypatch.setenv("WRONGTURN_SUBMISSIONS", "0")
    assert check_of_submissions()[1]
