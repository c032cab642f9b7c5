"""The calls of submissions: what is sent, what is repeated, and what is refused."""

from pathlib import Path

import httpx
import pytest
from client_fake_service import problem
from client_fake_submissions import FakeSubmissions, form_of

from wrongturn_client import (
    AgentNameTakenError,
    AuthenticationError,
    Client,
    ModelFileError,
    ServiceBusyError,
    SubmissionsUnavailableError,
)
from wrongturn_protocol import ProblemType, SubmissionState

MODEL = bytes(range(256)) * 1000


@pytest.fixture
def service() -> FakeSubmissions:
    service = FakeSubmissions()
    service.owners["ours"] = "us"
    return service


@pytest.fixture
def model(tmp_path: Path) -> Path:
    path = tmp_path / "my agent.onnx"
    path.write_bytes(MODEL)
    return path


def test_the_form_has_the_file_last_and_its_progress_is_told(service: FakeSubmissions, model: Path) -> None:
    told: list[tuple[int, int]] = []
    with Client("http://fake", "ours", transport=service.transport) as client:
        detail = client.submit(model, "smoke@3", "mine", progress=lambda *done: told.append(done))
    (form,) = service.forms
    assert list(form) == ["suite", "name", "model"]
    assert form == {"suite": (None, b"smoke@3"), "name": (None, b"mine"), "model": ("my agent.onnx", MODEL)}
    assert (detail.id, detail.state, detail.owner, detail.size) == ("s1", SubmissionState.QUEUED, "us", len(MODEL))
    sent = [done for done, _ in told]
    assert sent == sorted(sent)
    assert len(set(sent)) > 2
    assert told[-1] == (len(MODEL), len(MODEL))


def test_the_file_is_read_while_it_is_sent(service: FakeSubmissions, tmp_path: Path) -> None:
    """A model that has not arrived is not in memory: the body says its length and comes in pieces."""
    path = tmp_path / "m.onnx"
    path.write_bytes(bytes(1 << 20))
    pieces: list[int] = []

    class Watching(httpx.BaseTransport):
        def handle_request(self, request: httpx.Request) -> httpx.Response:
            assert isinstance(request.stream, httpx.SyncByteStream)
            pieces.extend(len(piece) for piece in request.stream)
            assert sum(pieces) == int(request.headers["content-length"])
            return problem(ProblemType.RATE_LIMITED, 429)

    with Client("http://fake", "ours", transport=Watching(), patience=0) as client, pytest.raises(ServiceBusyError):
        client.submit(path, "smoke@3", "mine")
    assert max(pieces) <= 1 << 17


def test_a_repeated_upload_sends_the_whole_file_with_the_same_key(service: FakeSubmissions, model: Path) -> None:
    broken = [httpx.ReadError("reset"), httpx.WriteError("reset")]
    seen: list[httpx.Request] = []

    def lose(request: httpx.Request) -> Exception | None:
        seen.append(request)
        return broken.pop() if broken else None

    service.after = lose
    with Client("http://fake", "ours", transport=service.transport) as client:
        client.live()
        seen.clear()
        broken[:] = [httpx.ReadError("reset"), httpx.WriteError("reset")]
        detail = client.submit(model, "smoke@3", "mine")
        client.submit(model, "smoke@3", "another")
    assert detail.name == "mine"
    assert [form_of(request)["model"][1] for request in seen] == [MODEL] * 4
    keys = [request.headers["idempotency-key"] for request in seen]
    assert keys[0] == keys[1] == keys[2] != keys[3]
    assert len(service.forms) == 2  # the repetitions got the stored reply


@pytest.mark.parametrize("name", ["missing.onnx", "."])
def test_a_file_that_cannot_be_read_is_named(service: FakeSubmissions, tmp_path: Path, name: str) -> None:
    with (
        Client("http://fake", "ours", transport=service.transport) as client,
        pytest.raises(ModelFileError, match=r"model: .* cannot be read: "),
    ):
        client.submit(tmp_path / name, "smoke@3", "mine")
    assert service.forms == []


def test_refusals_are_errors_of_their_own(service: FakeSubmissions, model: Path) -> None:
    with Client("http://fake", "ours", transport=service.transport) as client:
        with pytest.raises(AgentNameTakenError):
            client.submit(model, "smoke@3", "taken")
        service.inject = lambda _: problem(ProblemType.SUBMISSIONS_UNAVAILABLE, 503, "no sandbox here")
        sent = len(service.requests)
        with pytest.raises(SubmissionsUnavailableError, match="no sandbox here"):
            client.submit(model, "smoke@3", "mine")
        assert len(service.requests) == sent + 1  # waiting would not help
    service.inject = None
    with Client("http://fake", "theirs", transport=service.transport) as client, pytest.raises(AuthenticationError):
        client.submit(model, "smoke@3", "mine")


def test_an_empty_token_sends_none(service: FakeSubmissions, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("WRONGTURN_TOKEN", "ours")
    with Client("http://fake", "", transport=service.transport) as client:
        client.live()
    assert "authorization" not in service.requests[-1].headers
