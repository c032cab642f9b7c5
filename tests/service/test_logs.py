"""The log is for people who must not get to know a token by it."""

import json
import subprocess
import sys

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
