"""``wrongturn admin`` against a service: what an operator types, and what is said."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from service_harness import expect
from submission_story import OPERATOR, TakingService
from typer.testing import CliRunner, Result

from wrongturn_client.cli import app

Run = Callable[..., Result]


@pytest.fixture
def service(tmp_path: Path) -> Iterator[TakingService]:
    running = TakingService(tmp_path)
    yield running
    running.close()


@pytest.fixture
def run(service: TakingService, monkeypatch: pytest.MonkeyPatch) -> Run:
    monkeypatch.setenv("WRONGTURN_URL", service.url)
    monkeypatch.setenv("WRONGTURN_OPERATOR_TOKEN", OPERATOR)

    def run(*arguments: str, answer: str = "") -> Result:
        return CliRunner().invoke(app, ["admin", *arguments], input=answer)

    return run


@pytest.fixture
def http(service: TakingService) -> Iterator[httpx.Client]:
    """A client with the token of the owner "ada"."""
    headers = {"Authorization": f"Bearer {service.owner('ada')}"}
    with httpx.Client(base_url=service.url, headers=headers, timeout=60) as http:
        yield http


def test_an_operators_commands(http: httpx.Client, run: Run) -> None:
    for name in ("hers", "her other"):
        expect(http.post("/v1/agents", json={"name": name, "track": "camera"}), 201)
    listed = json.loads(run("agents", "--name", "HER", "--json").stdout)
    assert [one["name"] for one in listed] == ["her other", "hers"]
    hers = listed[1]["id"]
    table = run("agents").stdout
    assert hers in table
    assert "camera" in table
    assert "There are no such agents" in run("agents", "--hidden").stdout
    assert "hidden" in run("hide", "agent:hers", "--reason", "a test").stdout
    assert "was hidden before" in run("hide", hers).stdout
    assert hers in run("agents", "--hidden").stdout
    assert http.get(f"/v1/agents/{hers}", headers={"Authorization": ""}).status_code == 404
    assert "shown again" in run("unhide", hers).stdout
    assert "tokens ended: 3" in run("revoke", "owner:ada").stdout
    assert "holds: 1 owner, 2 agents" in run("show", "owner:ADA").stdout

    dry = run("delete", "agent:hers", "--dry-run")
    assert "1 agent" in dry.stderr
    assert run("delete", "agent:hers", answer="n\n").exit_code == 1
    assert "hers" in run("agents").stdout
    assert "Stays taken: the name 'hers' of an agent" in run("delete", "agent:hers", answer="y\n").stdout
    again = run("delete", hers, "--free", "--yes", "--json")
    assert json.loads(again.stdout)["held"] == []
    assert json.loads(run("usage", "--json").stdout)["total"]["agents"] == 1
    assert "ada" in run("usage").stdout
    log = json.loads(run("audit", "--json").stdout)
    assert [entry["action"] for entry in log] == ["free", "delete", "revoke", "unhide", "hide"]
    assert "a test" in run("audit", "--action", "hide").stdout
    # By a name too, also of what is deleted.
    named = json.loads(run("audit", "--target", "agent:HERS", "--json").stdout)
    assert named == json.loads(run("audit", "--target", hers, "--json").stdout)
    assert len(named) == 4
    assert "There are no such entries." in run("audit", "--target", "owner:nobody").stdout
    assert "her other" in run("agents", "--owner", "ADA").stdout
    assert "contact" in run("owners", "--name", "ada").stdout


def test_what_is_copied_from_a_table_is_never_broken(
    http: httpx.Client, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = "a name of many letters that goes on to the end"
    expect(http.post("/v1/agents", json={"name": name, "track": "camera"}), 201)
    agent = json.loads(run("agents", "--owner", "ada", "--json").stdout)[0]
    owner = json.loads(run("owners", "--name", "ada", "--json").stdout)[0]
    monkeypatch.setattr("wrongturn_client.tables.WIDTH", 80)
    table = run("agents", "--owner", "ada").stdout
    for whole in (agent["id"], owner["id"], name, _minute(agent["created"])):
        assert whole in table
    assert run("agents", "--owner", "owner:ada").stdout == table
    assert f"{_minute(owner['created'])} " in run("owners").stdout


def _minute(time: str) -> str:
    """As a table shows a time of the interface."""
    return f"{time[:10]} {time[11:16]}"


def test_usage_goes_on_where_a_list_ended(http: httpx.Client, run: Run) -> None:
    key = {"Idempotency-Key": "again"}
    expect(http.post("/v1/agents", json={"name": "hers", "track": "camera"}, headers=key), 201)
    first = json.loads(run("usage", "--json", "--limit", "1").stdout)
    assert [(one["name"], one["contents"]["replies"]) for one in first["owners"]] == [("ada", 1)]
    assert first["total"]["replies"] == 1
    rest = json.loads(run("usage", "--json", "--cursor", first["next"]).stdout)
    assert len(rest["owners"]) == first["total"]["owners"] - 1
    assert rest["next"] is None


def test_what_is_wrong_is_said(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for arguments, said in (
        (("show", "hers"), "neither an id"),
        (("show", "agent:nobody"), "there is no agent 'nobody'"),
        (("delete", "ag_none", "--yes"), "there is no agent 'ag_none'"),
        (("delete", "ag_none", "--dry-run"), "there is no agent 'ag_none'"),
        (("rotate-token", str(tmp_path / "a typo")), "no token has changed"),
        (("rotate-token", str(tmp_path / "no folder" / "token"), "--create"), "cannot be written"),
        (("agents", "--owner", "nobody"), "there is no owner 'nobody'"),
        (("evaluations", "--agent", "agent:nobody"), "there is no agent 'nobody'"),
        (("evaluations", "--state", "nonsense"), "running, finished or cancelled"),
        (("submissions", "--state", "nonsense"), "queued, checked, running, finished, failed or cancelled"),
        (("evaluations", "--suite", "nonsense"), "nonsense"),
        (("audit", "--target", "dog:rex"), "owner:NAME or agent:NAME"),
    ):
        found = run(*arguments)
        assert found.exit_code == 1
        assert said in str(found.exception), arguments
    monkeypatch.setenv("WRONGTURN_OPERATOR_TOKEN", "somebody's")
    assert "nobody has this token" in str(run("agents").exception)
    monkeypatch.delenv("WRONGTURN_OPERATOR_TOKEN")
    monkeypatch.delenv("WRONGTURN_TOKEN", raising=False)
    assert "WRONGTURN_OPERATOR_TOKEN" in str(run("agents").exception)


def test_a_token_is_rotated_in_its_file(run: Run, tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text("an older and much longer token than the new one will ever be, which has to be gone\n")
    before = file.stat().st_ino
    assert run("rotate-token", str(file)).exit_code == 0
    new = file.read_text()
    assert new.startswith("wt_")
    assert len(new.strip()) == 46
    assert new.count("\n") == 1
    assert file.stat().st_ino == before  # a container that has it mounted sees the new token
    assert run("rotate-token", str(tmp_path / "fresh"), "--create").exit_code == 0
    assert (tmp_path / "fresh").stat().st_mode & 0o777 == 0o600
