"""Whatever is killed, no result is lost, doubled or bent.

The long run, 200 kills over both databases, is ``script/test tests/faults -m soak -s``; it prints what it found.
``WRONGTURN_FAULT_SEED`` gives it other moments.
"""

import contextlib
import os
from pathlib import Path

import pytest
from campaign import Report, run
from databases import File, Server
from moments import ALL, NO_SERVER, moments
from postgres_server import running_server


def check(report: Report, kills: int) -> None:
    report.show()
    assert report.kills.total() == kills
    assert not report.findings.bad, report.findings.bad
    assert report.findings.acknowledged > 0
    # Nobody is there, for longer than a client that has just come waits: its owner starts it again. Nothing else.
    assert set(report.gave_up) <= {"ServiceUnreachableError"}


@pytest.mark.soak  # tests/service/test_recovery.py and tests/agents/test_worker.py kill each part once
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("database", ["SQLite", "PostgreSQL"])
def test_a_hundred_kills(database: str, tmp_path: Path) -> None:
    seed = int(os.environ.get("WRONGTURN_FAULT_SEED", "3"))
    with running_server() if database == "PostgreSQL" else contextlib.nullcontext() as found:
        store, victims = (Server(found.server), ALL) if found is not None else (File(tmp_path), NO_SERVER)
        check(run(store, tmp_path, moments(seed, 100, victims)), 100)
