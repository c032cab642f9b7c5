"""A service of one's own comes up, says why where it does not, and is gone afterwards."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from wrongturn_client import LocalService, LocalServiceError, local_service

READY = "print('Wrongturn is ready at http://127.0.0.1:4711', flush=True)"


@pytest.fixture
def program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What takes the place of ``python -m wrongturn_client serve``."""
    script = tmp_path / "fake.py"
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" "{script}" "$@"\n')
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    return script


def _gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_gives_its_url_and_ends_by_sigterm(program: Path, tmp_path: Path) -> None:
    program.write_text(
        f"""
import os, pathlib, signal, sys, time
def stop(*_):
    pathlib.Path({str(tmp_path / "stopped")!r}).write_text(" ".join(sys.argv[1:]) + os.environ["COLOUR"])
    sys.exit(0)
signal.signal(signal.SIGTERM, stop)
print("a word on stderr", file=sys.stderr, flush=True)
print("some banner")
{READY}
for _ in range(20000): print("noise that nobody reads must not block it")
time.sleep(60)
"""
    )
    log = tmp_path / "log"
    with LocalService(database="sqlite+aiosqlite:///x.db", environment={"COLOUR": "blue"}, log=log) as service:
        assert service.url == "http://127.0.0.1:4711"
        pid = service.pid
        time.sleep(0.2)
    assert _gone(pid)
    told = (tmp_path / "stopped").read_text()
    assert "serve --host 127.0.0.1 --port 0 --database sqlite+aiosqlite:///x.db" in told
    assert told.endswith("blue")
    assert log.read_text() == "a word on stderr\n"


def test_one_that_ends_shows_its_last_words(program: Path) -> None:
    program.write_text("import sys; [print('line', n, file=sys.stderr) for n in range(99)]; sys.exit(3)")
    with pytest.raises(LocalServiceError, match="ended with status 3") as caught, LocalService():
        pass
    assert "line 98" in str(caught.value)
    assert "line 5\n" not in str(caught.value)


def test_one_that_says_nothing_is_ended(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program.write_text("import time; time.sleep(60)")
    monkeypatch.setattr(local_service, "_START_S", 0.3)
    service = LocalService()
    with pytest.raises(LocalServiceError, match="not ready within 0 s; it said nothing on stderr"), service:
        pass
    assert _gone(service.pid)


def test_one_that_does_not_heed_is_killed(program: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_service, "_STOP_S", 0.2)
    program.write_text(f"import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); {READY}; time.sleep(60)")
    with LocalService() as service:
        pid = service.pid
    assert _gone(pid)


def test_it_runs_only_while_it_is_started() -> None:
    with pytest.raises(LocalServiceError, match="with block"):
        _ = LocalService().pid


def test_it_starts_and_stops_without_a_block(program: Path) -> None:
    program.write_text(f"import time\n{READY}\ntime.sleep(60)")
    service = LocalService()
    for _ in range(2):
        assert service.start() is service
        assert service.url == "http://127.0.0.1:4711"
        with pytest.raises(LocalServiceError, match=r"runs already, at http://127\.0\.0\.1:4711"):
            service.start()
        pid = service.pid
        service.stop()
        assert _gone(pid)


def test_it_ends_with_a_process_that_is_killed(tmp_path: Path) -> None:
    script = (
        "import threading; from wrongturn_client import LocalService\n"
        f"service = LocalService(database='sqlite+aiosqlite:///{tmp_path / 'killed.db'}').start()\n"
        "print(service.pid, flush=True); threading.Event().wait()"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        parent.kill()
    deadline = time.monotonic() + 60
    while not _gone(pid):
        assert time.monotonic() < deadline
        time.sleep(0.1)


def test_it_ends_with_the_process_that_started_it(program: Path) -> None:
    program.write_text(f"import time\n{READY}\ntime.sleep(60)")
    script = (
        "import sys; from wrongturn_client import LocalService\n"
        f"sys.executable = {sys.executable!r}\n"
        "print(LocalService().start().pid)"
    )
    real = str(Path(sys.prefix) / "bin" / "python")
    done = subprocess.run([real, "-c", script], capture_output=True, text=True, check=True)
    assert _gone(int(done.stdout))
