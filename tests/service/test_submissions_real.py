"""Models that are handed in over HTTP to a real service: the real runner, the real sandbox, the real simulation."""

import http.client
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from corpus import CORPUS, By, Case
from corpus_files import MARK
from service_harness import RunningService, expect, running_service
from submission_owner import Owner

PATIENCE_S = 600.0
SOME = ("a-gibibyte-and-more", "cut-off", "memory-expand", "crash", "output-missing")
"""Uploads of the corpus for every run of the tests: one for each place that refuses them."""


@pytest.fixture(scope="module")
def serving(bubblewrap: None, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningService]:
    folder = tmp_path_factory.mktemp("real")
    given = {"simulators": 4, "submissions": 2, "submissions_per_owner": 200}
    with running_service(folder / "wrongturn.db", **given) as running:
        yield running


def outcome(owner: Owner, case: Case, folder: Path) -> str:
    """Return the reason for which an upload is refused, at once or by the check."""
    reason = outcome_once(owner, case, folder)
    if "took longer" in reason and "took longer" not in case.words:  # the machine stood still meanwhile
        reason = outcome_once(owner, case, folder)
    return reason


def outcome_once(owner: Owner, case: Case, folder: Path) -> str:
    if case.by is By.SIZE:
        return announced(owner, case.length or 0)
    file = case.write(folder)
    response = owner.post(file.read_bytes(), f"case {case.name}")
    file.unlink()
    if response.status_code != 202:
        return str(response.json()["detail"])
    found = owner.until(response.json()["id"], "failed", seconds=PATIENCE_S)
    assert "agent" not in found
    assert owner.log(found["id"])[-1].endswith(found["reason"])
    return str(found["reason"])


def announced(owner: Owner, length: int) -> str:
    """Announce a body, begin to send it, and return why the service does not want it."""
    place = owner.http.base_url
    connection = http.client.HTTPConnection(place.host, place.port, timeout=60)
    connection.putrequest("POST", "/v1/submissions")
    connection.putheader("Authorization", f"Bearer {owner.token}")
    connection.putheader("Content-Type", "multipart/form-data; boundary=x")
    connection.putheader("Content-Length", str(length))
    connection.endheaders(b"--x\r\n")
    answer = connection.getresponse()
    said = json.loads(answer.read())
    connection.close()
    assert answer.status == 413, said
    return str(said["detail"])


@pytest.mark.parametrize("case", [case for case in CORPUS if case.name in SOME], ids=lambda case: case.name)
def test_hostile_uploads_fail_with_their_reasons(owner: Owner, tmp_path: Path, case: Case) -> None:
    """Some of each kind; tests/sandbox has the whole corpus."""
    reason = outcome(owner, case, tmp_path)
    assert case.words.lower() in reason.lower()
    assert reason.isprintable()
    assert not MARK.exists()
    names = {agent["name"] for agent in expect(owner.http.get("/v1/agents?all=true&limit=500"), 200)["agents"]}
    assert f"case {case.name}" not in names
