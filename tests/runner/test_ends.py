"""How a runner ends when the service does, or wants it to."""

import sys
from pathlib import Path

import psutil
import pytest
from program import Runner, check_of, drive_of, failing, stored
from small_models import steady

from wrongturn_client import LocalService
from wrongturn_runner.messages import Described, DriveJob, Driven, Progressed

pytestmark = pytest.mark.usefixtures("bubblewrap")

QUICK_S = 5.0
"""Far below any patience; a machine under load needs a part of it."""


def driving(runner: Runner, job: DriveJob) -> list[psutil.Process]:
    """Let a runner begin to drive, and return its sandboxes."""
    runner.tell(job)
    assert isinstance(runner.hear(), Progressed)
    assert isinstance(runner.hear(), Progressed)
    sandboxes = runner.sandboxes()
    assert sandboxes
    return sandboxes


def assert_gone(processes: list[psutil.Process]) -> None:
    _, alive = psutil.wait_procs(processes, timeout=QUICK_S)
    assert not [process for process in alive if process.is_running() and process.status() != psutil.STATUS_ZOMBIE]


@pytest.mark.parametrize("told", [False, True])
def test_it_ends_with_its_stdin_or_when_it_is_told_to(tmp_path: Path, service: LocalService, told: bool) -> None:
    with Runner(tmp_path) as runner:
        sandboxes = driving(runner, drive_of(tmp_path, steady(), service))
        if told:
            runner.process.terminate()
        else:
            runner.close_stdin()
        assert runner.status(QUICK_S) != 0
        assert not runner.log
        assert_gone(sandboxes)


def test_it_ends_while_it_waits_for_practice(tmp_path: Path, service: LocalService) -> None:
    with Runner(tmp_path) as runner:
        runner.tell(check_of(tmp_path, steady(), service.url))
        assert isinstance(runner.hear(), Described)
        sandboxes = runner.sandboxes()
        runner.close_stdin()
        assert runner.status(QUICK_S) == 1
        assert_gone(sandboxes)


def test_it_gives_up_where_nobody_answers(tmp_path: Path) -> None:
    job = DriveJob(
        **stored(tmp_path, steady()), url="http://127.0.0.1:9", token="none", evaluation="none", suite="smoke@3"
    )
    assert "no Wrongturn service answers at http://127.0.0.1:9" in failing(tmp_path, job)


def test_its_token_is_nowhere_to_be_read(tmp_path: Path, service: LocalService) -> None:
    job = drive_of(tmp_path, steady(), service)
    with Runner(tmp_path) as runner:
        for process in (psutil.Process(runner.process.pid), *driving(runner, job)):
            try:
                said = [*process.cmdline(), *process.environ().values()]
            except (psutil.AccessDenied, psutil.NoSuchProcess):
                continue
            assert not any(job.token in text for text in said)
        runner.events()
        assert job.token not in runner.log


def test_what_else_prints_does_not_come_between_its_events(tmp_path: Path) -> None:
    program = (
        "from wrongturn_runner.conversation import Conversation; from wrongturn_runner.messages import Driven;"
        "c = Conversation(); print('hello', flush=True); c.tell(Driven())"
    )
    with Runner(tmp_path, (sys.executable, "-c", program)) as runner:
        assert runner.events() == [Driven()]
        assert runner.status() == 0
        assert runner.log == "hello\n"
