"""A check by the runner, against a real service."""

import re
import uuid
from pathlib import Path

import httpx
import pytest
from program import Event, Runner, check_of, failing
from small_models import forgetful, not_a_number_above, of_input, slow, steady

from wrongturn_client import Client, LocalService
from wrongturn_protocol import Track
from wrongturn_runner.conversation import ModelAtFaultError
from wrongturn_runner.jobs import check
from wrongturn_runner.messages import Described, Passed, PracticeJob, Refused

pytestmark = pytest.mark.usefixtures("bubblewrap")

SUITE = "smoke@3"


def practice(service: LocalService, track: Track = Track.PRIVILEGED) -> PracticeJob:
    with Client(service.url) as client:
        token = client.register(f"checked {uuid.uuid4().hex[:8]}", track).token
        return PracticeJob(token=token, suite=SUITE, trial=client.trials(SUITE)[0].id)


def checked(folder: Path, service: LocalService, model: bytes) -> list[Event]:
    """Return the events of a check by the program, with practice if the model gets so far."""
    with Runner(folder) as runner:
        runner.tell(check_of(folder, model, service.url))
        first = runner.hear()
        if isinstance(first, Described):
            runner.tell(practice(service, first.track))
        events = [first, *runner.events()]
        assert runner.status() == 0, runner.log
        assert not runner.log
    return [event for event in events if event is not None]


class Listening:
    """In place of a conversation, in this process."""

    def __init__(self, service: LocalService) -> None:
        self._service = service
        self.described: Described | None = None

    def tell(self, event: Described) -> None:
        self.described = event

    def read(self, _kind: object) -> PracticeJob:
        assert self.described is not None
        return practice(self._service, self.described.track)


def refusal(folder: Path, service: LocalService, model: bytes, *tracks: Track, agent: Track | None = None) -> str:
    """Return why a check refuses a model."""
    job = check_of(folder, model, service.url, *tracks).model_copy(update={"agent_track": agent})
    with pytest.raises(ModelAtFaultError) as refused:
        check(job, Listening(service))  # type: ignore[arg-type]
    return str(refused.value)


def open_episodes(service: LocalService) -> float:
    operator = {"Authorization": "Bearer operator-token-of-the-tests-0123456789"}
    metrics = httpx.get(f"{service.url}/metrics", headers=operator).text
    (found,) = re.findall(r"^wrongturn_open_episodes (\S+)$", metrics, re.MULTILINE)
    return float(found)


def test_a_model_that_works_passes(tmp_path: Path, service: LocalService) -> None:
    before = open_episodes(service)
    described, passed = checked(tmp_path, service, steady())
    assert isinstance(described, Described)
    assert described.track is Track.PRIVILEGED
    assert (described.about, described.trained_on_faults) == (None, False)
    assert "inputs speed float32[1, 1]; outputs steer float32[1, 1], accelerate" in described.description
    assert isinstance(passed, Passed)
    assert len(passed.step_ms) == 6
    assert all(0 < took < 3000 for took in passed.step_ms)
    assert open_episodes(service) <= before


@pytest.mark.parametrize(
    ("model", "tracks", "agent", "reason"),
    [
        (b"no model at all", (), None, "ONNX"),
        (steady(), (), Track.CAMERA, r"^inputs: the agent is of the camera track, and the model is of the privileged"),
        (
            steady(),
            (Track.CAMERA,),
            None,
            r"does not take the model's track, privileged; set the metadata's track to camera",
        ),
        (not_a_number_above(0.0), (), None, r"^at step 1 of an episode: output accelerate: is .*nan.*must be finite"),
        (forgetful(), (), None, r"^at step 2 of an episode: output state_out: 1 of its 1 numbers are not finite"),
    ],
)
def test_what_is_wrong_with_a_model_is_told(
    tmp_path: Path, service: LocalService, model: bytes, tracks: tuple[Track, ...], agent: Track | None, reason: str
) -> None:
    told = refusal(tmp_path, service, model, *tracks, agent=agent)
    assert re.search(reason, told), told


def test_what_the_metadata_says_of_the_agent_is_told(tmp_path: Path, service: LocalService) -> None:
    said = {"track": "privileged", "description": "  Drives\non. " + "x" * 3000, "trained_on_faults": "True"}
    listening = Listening(service)
    check(check_of(tmp_path, steady(metadata=said), service.url), listening)  # type: ignore[arg-type]
    described = listening.described
    assert described is not None
    assert described.trained_on_faults
    assert described.about is not None
    assert described.about.startswith("Drives on. xxx")
    assert len(described.about) == 2000


def test_a_slow_model_is_told_its_time(tmp_path: Path, service: LocalService) -> None:
    told = refusal(tmp_path, service, slow())
    assert re.search(r"took \d\.\d s|longer than|time", told), told


def test_a_name_of_strangers_is_cut_and_printable(tmp_path: Path, service: LocalService) -> None:
    refused = checked(tmp_path, service, of_input("evil\x1b[2J\n\u202e" + "x" * 5000))[-1]
    assert isinstance(refused, Refused)
    assert refused.reason.isprintable()
    assert len(refused.reason) <= 500


def test_a_damaged_file_is_not_the_models_fault(tmp_path: Path, service: LocalService) -> None:
    job = check_of(tmp_path, steady(), service.url)
    job.model.write_bytes(steady(accelerate=0.7))
    assert "damaged" in failing(tmp_path, job)


def test_a_message_that_cannot_be_read_keeps_its_token_secret(tmp_path: Path, service: LocalService) -> None:
    with Runner(tmp_path) as runner:
        assert runner.process.stdin is not None
        runner.process.stdin.write(b'{"task": "drive", "token": "very-secret"}\n')
        runner.process.stdin.flush()
        assert runner.status() == 1
        assert "model: Field required" in runner.log
        assert "very-secret" not in runner.log
