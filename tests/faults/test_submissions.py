"""Whatever is killed, a submission comes to its end, once, and as if nothing had happened.

The longer run, 20 kills, is ``script/test tests/faults/test_submissions.py -m soak -s``. ``WRONGTURN_FAULT_SEED`` gives
it other moments.
"""

import os
from pathlib import Path

import pytest
from submission_campaign import Report, blows, run

pytestmark = pytest.mark.usefixtures("bubblewrap")


def check(report: Report, kills: int) -> None:
    print(f"kills: {dict(report.kills)}; states at a kill: {dict(report.during)}; ", end="")
    print(f"{len(report.submissions)} submissions; {report.lost} episodes driven again")
    assert report.kills.total() == kills
    assert not report.bad, report.bad
    assert report.submissions


@pytest.mark.soak  # tests/service/test_submissions_dispatch.py stops and kills each part once
def test_a_submission_survives_a_few_kills(tmp_path: Path) -> None:
    """Three kills have one of each kind."""
    check(run(tmp_path, blows(1, 3), spare=0), 3)


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_submissions_survive_many_kills(tmp_path: Path) -> None:
    seed = int(os.environ.get("WRONGTURN_FAULT_SEED", "3"))
    check(run(tmp_path, blows(seed, 20)), 20)
