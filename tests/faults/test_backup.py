"""A backup made by the command while agents drive, put back by the command, and gone on with."""

import subprocess
import sys
from pathlib import Path

import pytest
from campaign import Seat
from databases import File, Store
from ledger import journal, results
from processes import Kept, Service, until
from worker import SOCKET

DRIVES = ("careful", SOCKET, 1)


def finals(seat: Seat) -> set[tuple[str, int]]:
    return {(line["episode"], line["seq"]) for line in journal(seat.journals) if line["what"] == "final"}


def command(*arguments: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "wrongturn_client", *arguments], capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr


def running(store: Store, folder: Path) -> Service:
    service = Service(store.url, folder / "service.log", simulators=2, spare_simulators=0)
    service.start()
    service.await_ready()
    return service


@pytest.mark.soak  # CI puts a backup back in tests/service/test_new_machine.py
def test_what_was_acknowledged_is_in_a_backup_and_the_rest_is_driven_again(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    first, second = File(tmp_path / "a"), File(tmp_path / "b")
    file = str(tmp_path / "backup")
    service = running(first, tmp_path)
    seat = Seat(service, tmp_path, "one", DRIVES)
    try:
        seat.last.set()
        seat.thread.start()
        until(lambda: len(finals(seat)) >= 2, 60.0, "nothing was driven")
        before = finals(seat)
        command("backup", file, "--database", first.url)
        seat.thread.join(120.0)
        assert seat.error is None
    finally:
        seat.stop()
        service.stop()
    (evaluation,) = seat.evaluations
    whole = results(first, evaluation)
    assert len(whole) == 12

    command("restore", file, "--database", second.url, "--yes")
    kept = {(row["id"], row["steps"]) for row in second.rows("SELECT id, steps FROM episodes WHERE state = 'finished'")}
    assert before <= kept
    service = running(second, tmp_path)
    worker = Kept(seat.command(service.url, evaluation), tmp_path / "again.log", {})
    try:
        worker.start()
        assert worker.wait(120.0)
    finally:
        worker.stop()
        service.stop()
    assert results(second, evaluation) == whole
    (row,) = second.rows("SELECT state FROM evaluations")
    assert row["state"] == "finished"
