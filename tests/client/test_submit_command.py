"""``wrongturn submit`` as a user would try it, against a service in memory."""

import getpass
import io
import json
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import onnx
import pytest
from client_fake_submissions import TIME, WAY, FakeSubmissions
from onnx import TensorProto, helper
from rich.console import Console
from typer.testing import CliRunner, Result

from wrongturn_client import Client, WrongturnError, cli, following, submitter, submitting, transport
from wrongturn_client.submitter import KeptOwner, OwnerTokens
from wrongturn_protocol import SubmissionDetail
from wrongturn_protocol.submissions import SubmissionLogLine

URL = "http://fake:80"


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(getpass, "getuser", lambda: "ann")
    return tmp_path / "home"


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch, home: Path) -> FakeSubmissions:
    service = FakeSubmissions()

    def client(url: str | None = None, token: str | None = None, **options: Any) -> Client:
        return Client(url, token, transport=service.transport, **options)

    monkeypatch.setattr(submitting, "Client", client)
    monkeypatch.setattr(submitter, "Client", client)
    monkeypatch.setattr(following, "_PAUSE", 0.0)
    monkeypatch.setattr(transport, "_SHORTEST_PAUSE", 0.0)
    return service


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return write_model(tmp_path / "my_agent.onnx")


def write_model(path: Path, speed: int = TensorProto.FLOAT, wide: int = 1, **metadata: str) -> Path:
    """Write a model of 5 kB for the camera track; its input ``speed`` has this type and this many numbers."""
    graph = helper.make_graph(
        [helper.make_node("Identity", ["speed"], ["steer"]), helper.make_node("Identity", ["speed"], ["accelerate"])],
        "graph",
        [helper.make_tensor_value_info("speed", speed, ["N", wide])],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["N", 1]) for name in ("steer", "accelerate")],
        doc_string="x" * 4800,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"track": "camera", **metadata})
    path.write_bytes(model.SerializeToString())
    return path


def submit(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli.app, ["submit", *map(str, arguments), "--url", URL])


def refused(*arguments: str | Path) -> str:
    done = submit(*arguments)
    assert isinstance(done.exception, WrongturnError), done.output
    return str(done.exception)


def test_it_follows_a_submission_to_its_rank(served: FakeSubmissions, model: Path) -> None:
    done = submit(model, "--suite", "smoke@3")
    assert done.exit_code == 0, done.output
    said = done.stderr.splitlines()
    assert "Handed in as s1: my_agent on smoke@3 at http://fake:80, owner ann." in said
    shown = [line.removeprefix("my_agent: ") for line in said if line.startswith("my_agent: ")]
    assert shown == ["5.0 kB sent", "waits for its check", "checked, 1 before it", "3 of 120 episodes", "finished"]
    news = [line.split(" ", 1)[1] for line in said if line[2:3] == ":" and line[5:6] == ":"]
    assert news == ["It waits for its check.", "Now checked.", "Now running.", "Now finished."]
    assert "infeasible" in done.stdout
    assert "Rank 1 of 1 in the camera track; unsafe 1 of 60 (strict), 95 % interval 0 to 50 %." in done.stdout


def test_one_that_is_not_ranked_says_why(served: FakeSubmissions, model: Path) -> None:
    served.why_not = "Completed 3 of 60 twins, at least 54 are needed."
    done = submit(model)
    assert done.exit_code == 0
    assert "Not ranked: Completed 3 of 60 twins, at least 54 are needed." in done.stdout
    assert served.detail["suite"] == "wrong-command-unseen@1"


@pytest.mark.parametrize("state", ["failed", "cancelled"])
def test_one_that_fails_says_why_and_exits_with_1(served: FakeSubmissions, model: Path, state: str) -> None:
    served.way = [WAY[0], {"state": state, "reason": "steer: has the shape (3,); give (1,)"}]
    done = submit(model)
    assert done.exit_code == 1
    assert done.stdout == f"my_agent {state}: steer: has the shape (3,); give (1,)\n"


def test_one_that_fails_while_it_drives_counts(served: FakeSubmissions, model: Path) -> None:
    served.way = [*WAY[:4], {"state": "failed", "evaluation": "e7", "reason": "steer is not finite"}]
    served.why_not = "57 of 60 trials were aborted."
    done = submit(model)
    assert done.exit_code == 1
    assert done.stdout.splitlines() == [
        "my_agent failed: steer is not finite",
        "Not ranked: 57 of 60 trials were aborted.",
    ]


def test_json_is_the_submission_and_its_entry(served: FakeSubmissions, model: Path) -> None:
    done = submit(model, "--json")
    found = json.loads(done.stdout)
    assert found["submission"]["state"] == "finished"
    assert found["entry"]["rank"] == 1
    assert found["entry"]["entry"] == "uploaded"
    served.way = [{"state": "failed", "reason": "no"}]
    done = submit(model, "--json", "--name", "two")
    assert done.exit_code == 1
    assert json.loads(done.stdout)["entry"] is None


def test_without_waiting_it_says_how_to_come_back(served: FakeSubmissions, model: Path) -> None:
    done = submit(model, "--no-wait")
    assert done.exit_code == 0
    command = done.stderr.splitlines()[-1].split(" submit ", 1)[1]
    assert command == "--follow s1 --url http://fake:80"
    done = submit("--follow", "s1")
    assert done.exit_code == 0
    assert "Rank 1 of 1" in done.stdout
    assert json.loads(submit(model, "--no-wait", "--json", "--name", "two").stdout)["submission"]["name"] == "two"


def test_ctrl_c_leaves_it_running(served: FakeSubmissions, model: Path) -> None:
    def interrupt(request: httpx.Request) -> None:
        if request.url.path.endswith("/log") and len(served.log) == 3:
            raise KeyboardInterrupt

    served.inject = interrupt
    done = submit(model)
    assert done.exit_code == 130
    assert "The submission goes on without you." in done.stderr
    assert "submit --follow s1 --url http://fake:80" in done.stderr
    assert "submit --cancel s1 --url http://fake:80" in done.stderr
    assert served.detail["state"] == "running"
    served.inject = None
    done = submit("--cancel", "s1")
    assert done.stdout == "Cancelled: my_agent on wrong-command-unseen@1.\n"
    assert submit("--follow", "s1").exit_code == 1


def test_what_is_over_cannot_be_cancelled(served: FakeSubmissions, model: Path) -> None:
    submit(model)
    done = submit("--cancel", "s1")
    assert done.exit_code == 0
    assert done.stdout == "Nothing is left to cancel: my_agent on wrong-command-unseen@1 is finished.\n"
    listed = CliRunner().invoke(cli.app, ["submissions", "--url", URL]).stdout
    assert "s1" in listed
    assert "finished" in listed


def test_all_submissions_belong_to_one_owner(served: FakeSubmissions, model: Path, home: Path) -> None:
    first = submit(model, "--no-wait")
    assert "Registered you as the owner 'ann'" in first.stderr
    assert str(home / "owners.json") in first.stderr
    second = submit(model, "--no-wait", "--name", "two")
    assert "Registered" not in second.stderr
    assert list(served.owners.values()) == ["ann"]
    assert (home / "owners.json").stat().st_mode & 0o777 == 0o600


def test_a_login_name_that_is_taken_gets_a_number(served: FakeSubmissions, model: Path) -> None:
    served.taken |= {"ann", "ann-2"}
    submit(model, "--no-wait")
    assert list(served.owners.values()) == ["ann-3"]


def test_owners_can_be_chosen(served: FakeSubmissions, model: Path) -> None:
    for name in ("our group", "ann", "our group"):
        submit(model, "--no-wait", "--owner-name", name)
        assert served.detail["owner"] == name
    submit(model, "--no-wait")
    assert served.detail["owner"] == "our group"  # the one used last
    assert list(served.owners.values()) == ["our group", "ann"]
    assert "'taken' is taken at http://fake:80" in refused(model, "--owner-name", "taken")
    assert "--owner-name: '-' cannot be a name" in refused(model, "--owner-name", "-")


def test_a_service_with_a_new_database_gets_a_new_owner(served: FakeSubmissions, model: Path) -> None:
    submit(model, "--no-wait")
    served.owners.clear()
    assert "Registered you as the owner 'ann'" in submit(model, "--no-wait").stderr
    assert served.detail["owner"] == "ann"


def test_a_kept_token_that_was_changed_says_what_to_do(served: FakeSubmissions, model: Path, home: Path) -> None:
    submit(model, "--no-wait")
    served.owners = {"new": "ann"}
    said = refused(model)
    assert said.startswith(f"{home / 'owners.json'}: http://fake:80 does not take its token")
    assert "set WRONGTURN_OWNER_TOKEN to the new one" in said


def test_a_token_of_the_environment_comes_first(
    served: FakeSubmissions, model: Path, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    served.owners["ours"] = "us"
    monkeypatch.setenv("WRONGTURN_OWNER_TOKEN", "ours")
    assert submit(model, "--no-wait").exit_code == 0
    assert served.detail["owner"] == "us"
    assert not (home / "owners.json").exists()
    monkeypatch.setenv("WRONGTURN_OWNER_TOKEN", "wrong")
    assert refused(model).startswith("WRONGTURN_OWNER_TOKEN: http://fake:80 does not take its token")


@pytest.mark.parametrize(("token", "name", "forms"), [("agent's", "the agent", 1), ("ours", "my_agent", 2)])
def test_the_other_variable_may_have_an_agents_token_or_an_owners(
    served: FakeSubmissions, model: Path, monkeypatch: pytest.MonkeyPatch, token: str, name: str, forms: int
) -> None:
    served.owners["ours"] = "us"
    monkeypatch.setenv("WRONGTURN_TOKEN", token)
    assert submit(model, "--no-wait").exit_code == 0
    assert (served.detail["name"], len(served.forms)) == (name, forms)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("gone.onnx", None, "cannot be read: No such file"),
        (".", None, "is a folder"),
        ("empty.onnx", b"", "is empty"),
        ("model.zip", b"PK\x03\x04", r" export sb3 \S*model.zip --out \S*model.onnx, then hand in "),
        ("model.onnx", b"PK\x03\x04", "torch.save"),
        ("model.pt", b"PK\x03\x04", "torch.save"),
        ("model.pkl", b"\x80\x04\x95", "is a pickle"),
        ("model.onnx", b"version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        ("model.bin", b"\x08\x08", "does not end in .onnx"),
        (".onnx", b"\x08\x08", "no name before .onnx"),
        ("模型.onnx", b"\x08\x08", "^FILE: '模型' cannot be the agent's name; choose another by --name"),
    ],
)
def test_a_file_that_is_no_model_is_told_before_anything_is_sent(
    served: FakeSubmissions, tmp_path: Path, name: str, content: bytes | None, says: str
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(WrongturnError, match=says):
        raise WrongturnError(refused(tmp_path / name))
    assert served.requests == []


def test_what_breaks_the_contract_is_told_before_anything_is_registered(
    served: FakeSubmissions, tmp_path: Path
) -> None:
    said = refused(write_model(tmp_path / "ints.onnx", TensorProto.INT64, 2))
    assert "ints.onnx: input speed: takes int64; let it take float32" in said
    assert "input speed: takes (N, 2); let it take (N, 1)" in said
    said = refused(write_model(tmp_path / "expert.onnx", track="privileged"))
    assert "inputs: the suite does not take the model's track, privileged; set the metadata's track to camera" in said
    whole = onnx.load(write_model(tmp_path / "split.onnx"))
    whole.graph.initializer.append(onnx.numpy_helper.from_array(np.zeros(2000, np.float32), "weights"))
    onnx.save(whole, tmp_path / "split.onnx", save_as_external_data=True, location="split.data")
    assert "split.onnx: weights lie in another file; store them in the model itself" in refused(tmp_path / "split.onnx")
    (tmp_path / "noise.onnx").write_bytes(bytes(range(8, 200)))
    assert "noise.onnx: the file is no ONNX model, or is cut off" in refused(tmp_path / "noise.onnx")
    assert served.owners == {}
    assert served.paths("POST") == []


def test_json_goes_into_a_file_beside_what_is_printed(served: FakeSubmissions, model: Path, tmp_path: Path) -> None:
    done = submit(model, "--json", tmp_path / "done.json")
    assert "Rank 1 of 1" in done.stdout
    assert json.loads((tmp_path / "done.json").read_text())["entry"]["rank"] == 1
    before = model.read_bytes()
    assert json.loads(submit("--json", model, "--name", "two", "--no-wait").stdout)["submission"]["name"] == "two"
    assert model.read_bytes() == before
    done = submit(model, "--name", "three", "--json", tmp_path / "no" / "done.json")
    assert "--json: " in str(done.exception)
    assert [form["name"][1] for form in served.forms] == [b"my_agent", b"two"]


def test_what_is_wrong_is_told_before_an_owner_is_registered(served: FakeSubmissions, model: Path) -> None:
    assert "there is no none@1" in refused(model, "--suite", "none@1")
    assert "--name: '?' cannot be a name" in refused(model, "--name", "?")
    assert "by --follow ID" in refused()
    assert refused(model, "--follow", "s1") == "FILE and --follow: give only one of them"
    assert refused("--follow", "s1", "--cancel", "s2") == "--follow and --cancel: give only one of them"
    assert "no token for http://fake:80 is known here" in refused("--follow", "s1")
    assert served.owners == {}


@pytest.mark.parametrize(
    ("state", "why"),
    [
        ("off: WRONGTURN_SUBMISSIONS is 0", "its operator turned them off"),
        ("off: bwrap is not installed", "it has no sandbox (bwrap is not installed)"),
    ],
)
def test_a_service_without_submissions_registers_nobody(
    served: FakeSubmissions, model: Path, state: str, why: str
) -> None:
    served.ready["submissions"] = state
    assert f"--url: http://fake:80 takes no submissions, because {why}" in refused(model)
    assert served.owners == {}
    assert served.paths("POST") == []


@pytest.mark.parametrize("status", [200, 404, 503])
def test_a_service_that_does_not_say_whether_it_takes_submissions_is_asked(
    served: FakeSubmissions, model: Path, status: int
) -> None:
    def silent(request: httpx.Request) -> httpx.Response | None:
        return httpx.Response(status, json={"status": "ok"}) if request.url.path == "/health/ready" else None

    served.inject = silent
    assert submit(model, "--no-wait").exit_code == 0


@pytest.mark.parametrize("option", ["--follow", "--cancel"])
def test_a_submission_of_another_owner_is_told_as_such(served: FakeSubmissions, model: Path, option: str) -> None:
    submit(model, "--no-wait")
    said = refused(option, "theirs")
    assert said.startswith("submission theirs belongs to another owner; choose its owner by --owner-name")


def test_a_list_that_cannot_be_asked_for_says_what_is_wrong(served: FakeSubmissions, model: Path) -> None:
    def listed(*arguments: str) -> str:
        return str(CliRunner().invoke(cli.app, ["submissions", *arguments]).exception)

    nobody = ["--url", URL, "--owner-name", "nobody"]
    said = "--owner-name: no token of an owner 'nobody' at http://fake:80 is known here; "
    assert listed(*nobody) == said + "leave it out and set WRONGTURN_OWNER_TOKEN to the owner's token"
    submit(model, "--no-wait")
    assert listed(*nobody) == said + "give one of 'ann'"
    assert "'127.0.0.1:18613' does not begin with http:// or https://" in listed("--url", "127.0.0.1:18613")


def test_an_agents_token_in_the_owners_variable_is_told(
    served: FakeSubmissions, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("WRONGTURN_OWNER_TOKEN", "agent's")
    assert "WRONGTURN_OWNER_TOKEN: it holds the token of an agent" in refused(model)
    assert "set WRONGTURN_TOKEN to it" in refused(model)


def test_a_name_that_is_taken_shows_another(served: FakeSubmissions, model: Path) -> None:
    assert refused(model, "--name", "taken") == "--name: taken is taken. Example: --name taken-2"


def test_kept_tokens_of_a_url_are_found_in_any_spelling(home: Path) -> None:
    kept = KeptOwner(id="1", name="us", token="secret")
    with OwnerTokens().locked():
        OwnerTokens().keep("HTTPS://Host/sub/", kept)
    assert OwnerTokens().find("https://host:443/sub") == kept
    assert OwnerTokens().find("https://host:444/sub") is None
    assert OwnerTokens().find("https://host/sub", "them") is None


def test_a_kept_file_that_is_damaged_is_left_alone(served: FakeSubmissions, model: Path, home: Path) -> None:
    home.mkdir()
    (home / "owners.json").write_text("{")
    assert "it does not hold what this program writes" in refused(model)
    assert (home / "owners.json").read_text() == "{"
    assert served.owners == {}


def test_a_home_that_cannot_be_written_registers_nobody(served: FakeSubmissions, model: Path, home: Path) -> None:
    home.write_text("a file where the folder should be")
    assert "a new owner's token would be lost" in refused(model)
    assert served.owners == {}


def test_a_terminal_has_one_line_with_a_bar_and_the_log_above_it() -> None:
    output = io.StringIO()
    console = Console(file=output, force_terminal=True, width=100, color_system=None)
    head = {"id": "s1", "suite": "smoke@3", "name": "mine", "owner": "us", "sha256": "0", "size": 1}
    with following.bars_on(console) as bars:
        line = following.Display("mine", console, bars)
        line.uploaded(2_000_000, 5_000_000)
        bars.refresh()
        line.news(SubmissionLogLine(time=TIME, message="It waits [for] its check."))
        for step in WAY:
            line.at(SubmissionDetail.model_validate({**head, **step, "created": TIME}))
            bars.refresh()
    shown = output.getvalue()
    assert "mine: 2.0 MB of 5.0 MB sent" in shown
    assert "It waits [for] its check.\n" in shown
    assert "mine: checked, is the next" in shown
    assert "mine: 3 of 120 episodes" in shown
    assert shown.rstrip("\x1b[?25h").count("\n") == 2  # the log's line and the end of the only other one


def test_plain_lines_about_one_state_keep_their_distance() -> None:
    output, now = io.StringIO(), [0.0]
    plain = following.Display("mine", Console(file=output), clock=lambda: now[0])
    running = {**WAY[3], "id": "s1", "suite": "smoke@3", "name": "mine", "owner": "us", "sha256": "0", "size": 1}
    for second in range(25):
        now[0] = float(second)
        plain.at(SubmissionDetail.model_validate({**running, "created": TIME, "finished": second}))
    assert output.getvalue().splitlines() == [f"mine: {done} of 120 episodes" for done in (0, 10, 20)]
