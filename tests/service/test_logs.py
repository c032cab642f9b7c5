"""The log is for people who must not get to know a token by it."""

import json
import subprocess
import sys
from pathlib import Path

import structlog
from app_harness import Clock, application
from service_harness import expect, problem
from test_metrics import figures

from wrongturn_service.logs import LogThrottle

PROGRAM = """
import structlog
from wrongturn_service import logs
logs.configure("info")
try:
    authorization = "Bearer wt_secret"
    raise ValueError("broken")
except ValueError as error:
    structlog.get_logger("errors").error("internal error", exc_info=error)
    import logging
    logging.getLogger("library").error("broken too", exc_info=error)
"""


def test_a_traceback_tells_where_and_no_local_variables() -> None:
    run = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True, timeout=60)
    ours, theirs = (json.loads(line) for line in run.stderr.splitlines())
    assert ours["exception"][0]["exc_value"] == "broken"
    assert ours["exception"][0]["frames"][0]["lineno"] == 7
    assert theirs["event"] == "broken too"
    assert "secret" not in run.stderr


async def test_a_flood_of_refusals_does_not_fill_the_log(tmp_path: Path) -> None:
    with structlog.testing.capture_logs() as lines:
        async with application(tmp_path) as http:
            for number in range(20):
                problem(await http.get(f"/nope/{number}"), 404, "unknown-route")
                problem(
                    await http.post("/v1/evaluations", headers={"Authorization": "Bearer no"}), 401, "unauthenticated"
                )
            expect(await http.get("/v1/suites"), 200)
            counted = await figures(http)
    told = [line for line in lines if line["event"] == "request" and line["log_level"] == "info"]
    assert [line["status"] for line in told if line["status"] >= 400] == [404, 401]
    assert {line["route"] for line in told if line["status"] == 200} == {"/v1/suites"}
    for kind in ("GET,unknown,404", "POST,/v1/evaluations,401"):
        assert counted[f"wrongturn_request_seconds_count,{kind}"] == 20


def test_what_was_not_logged_is_counted() -> None:
    clock = Clock()
    seldom = LogThrottle(10.0, clock)
    assert [seldom.others(404) for _ in range(4)] == [0, None, None, None]
    assert seldom.others(401) == 0
    clock.now = 10.0
    assert [seldom.others(404), seldom.others(404), seldom.others(401)] == [3, None, 0]
