"""Whatever is killed, a submission comes to its end, once, and as if nothing had happened.

``script/test tests/faults/test_submissions.py -m soak -s``. ``WRONGTURN_FAULT_SEED`` gives it other moments,
``WRONGTURN_FAULT_KILLS`` another number than 20.
"""

import os
from pathlib import Path

import pytest
from submission_campaign import blows, run

pytestmark = pytest.mark.usefixtures("bubblewrap")


@pytest.mark.soak  # tests/service/test_submissions_dispatch.py stops and kills each part once
@pytest.mark.timeout(1800)
def test_submissions_survive_many_kills(tmp_path: Path) -> None:
    seed, kills = int(os.environ.get("WRONGTURN_FAULT_SEED", "3")), int(os.environ.get("WRONGTURN_FAULT_KILLS", "20"))
    report = run(tmp_path, blows(seed, kills))
    print(f"kills: {dict(report.kills)}; states at a kill: {dict(report.during)}; ", end="")
    print(f"{len(report.submissions)} submissions; {report.lost} episodes driven again")
    assert report.kills.total() == kills
    assert not report.bad, report.bad
    assert report.submissions
