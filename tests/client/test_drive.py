"""Driving over the socket of a real service, and what is done when it breaks."""

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer

import httpx
import numpy as np
import pytest
from client_forwarder import STEPS_OVER_HTTP, Forwarder, figure

from wrongturn_client import (
    Action,
    ApiError,
    AuthenticationError,
    Client,
    EpisodeFinishedError,
    EvaluationFinishedError,
    LocalService,
    NotOfferedError,
    ServiceUnreachableError,
)
from wrongturn_protocol import EvaluationState, PracticeRequest, Track
from wrongturn_protocol.observations import Observation

GAS = Action(steer=0.0, throttle=0.8, brake=0.0)
REQUEST = PracticeRequest(town="Town01", approach="J3-S", seed=3, track=Track.SEGMENTATION)


class Gas:
    """Full throttle; counts its decisions, and may do something after some."""

    def __init__(self) -> None:
        self.steps = 0

    def reset(self, observation_space: object) -> None:
        pass

    def act(self, observation: Observation) -> Action:
        self.steps += 1
        return GAS


@pytest.fixture
def client(service: LocalService) -> Iterator[Client]:
    with Client(service.url) as anybody:
        agent = anybody.register(
            f"driver {threading.get_ident()} {np.random.default_rng().integers(2**40)}", Track.SEGMENTATION
        )
    with Client(service.url, agent.token) as client:
        yield client


@pytest.fixture
def forwarder(service: LocalService) -> Iterator[Forwarder]:
    forwarder = Forwarder(service.url)
    yield forwarder
    forwarder.close()


def test_a_drive_is_that_of_http(client: Client) -> None:
    with client.drive() as drive:
        here, there = drive.practise(REQUEST), client.practise(REQUEST)
        assert here.trial == there.trial
        for seq in range(1, 5):
            mine, other = drive.step(here.id, seq, GAS), client.step(there.id, seq, GAS)
            assert mine.reward == other.reward
            assert mine.observation.keys() == other.observation.keys()
            for name, array in mine.observation.items():
                np.testing.assert_array_equal(array, other.observation[name])
                assert array.flags.writeable
        looked = drive.episode(here.id)
        assert (looked.seq, looked.last_reply and looked.last_reply["seq"]) == (4, 4)
        drive.abort_episode(here.id)
        client.abort_episode(there.id)


def test_steps_go_in_one_message_and_fail_one_by_one(client: Client) -> None:
    with client.drive() as drive:
        one, two = drive.practise(REQUEST).id, drive.practise(REQUEST).id
        first, wrong, second = drive.steps([(one, 1, GAS), (one, 7, GAS), (two, 1, GAS)])
        assert not isinstance(first, ApiError)
        assert not isinstance(second, ApiError)
        assert isinstance(wrong, ApiError)
        assert wrong.type == "sequence-gap"
        drive.abort_episode(one)
        drive.abort_episode(two)
        with pytest.raises(EpisodeFinishedError):
            drive.step(one, 2, GAS)


def test_too_many_steps_for_a_message_are_refused_here(client: Client) -> None:
    with client.drive() as drive, pytest.raises(ValueError, match="1 to 256"):
        drive.steps([("ep", 1, GAS)] * 257)


def test_an_evaluation_goes_by_the_socket(client: Client) -> None:
    before = figure(client.url, STEPS_OVER_HTTP)
    told: list[int] = []
    evaluation = client.evaluate(Gas(), "smoke@3", parallel=3, progress=lambda done, of: told.append(done))
    assert evaluation.state is EvaluationState.FINISHED
    assert told == list(range(13))
    assert figure(client.url, STEPS_OVER_HTTP) == before
    assert evaluation.metrics is not None
    assert evaluation.metrics.unsafe.trials == 6
    assert evaluation.id in {entry.evaluation for entry in client.leaderboard("smoke@3").entries}
    with pytest.raises(EvaluationFinishedError):
        client.next_episode(evaluation.id)


def test_an_evaluation_goes_on_after_each_cut(client: Client, forwarder: Forwarder) -> None:
    """A connection that breaks costs no step and no episode: the record that is posted has to agree."""

    class Cutting(Gas):
        def act(self, observation: Observation) -> Action:
            if self.steps % 40 == 17:
                forwarder.cut()
            elif self.steps % 40 == 33:
                forwarder.cut_after = 0
            return super().act(observation)

    policy = Cutting()
    with Client(forwarder.url, client._token) as cut:
        evaluation = cut.evaluate(policy, "smoke@3", parallel=1)
    assert evaluation.state is EvaluationState.FINISHED
    assert forwarder.plugged > policy.steps // 20
    episodes = client.finished_episodes(evaluation.id)
    assert sum(episode.seq for episode in episodes) == policy.steps


def test_a_last_ping_that_cannot_be_answered_costs_no_step(client: Client, forwarder: Forwarder) -> None:
    with Client(forwarder.url, client._token) as hung, hung.drive() as drive:
        episode = drive.practise(REQUEST).id
        forwarder.hang_up()
        time.sleep(0.1)  # what is sent now is answered by a reset, behind the ping
        assert drive.step(episode, 1, GAS).seq == 1
        assert drive.step(episode, 2, GAS).seq == 2
        assert forwarder.plugged == 2
        drive.abort_episode(episode)


@pytest.fixture(params=[None, b""], ids=["refuses", "closes"])
def gone(request: pytest.FixtureRequest, forwarder: Forwarder, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Takes the service away for so many seconds, which are not waited for: they pass as the client sleeps.

    Meanwhile connections are refused, or taken and closed as by a forwarder of ports; or given an answer.
    """
    clock = [0.0]

    def go(seconds: float, answer: bytes | None = request.param) -> None:
        if answer is None:
            forwarder.unplug()
        else:
            forwarder.stand_in(answer)
        back = clock[0] + seconds

        def sleep(pause: float) -> None:
            before, clock[0] = clock[0], clock[0] + pause
            if before < back <= clock[0]:
                forwarder.plug()

        monkeypatch.setattr("wrongturn_client.transport.time.monotonic", lambda: clock[0])
        monkeypatch.setattr("wrongturn_client.transport.time.sleep", sleep)

    return go


def test_a_drive_bears_that_the_service_is_started_again(
    client: Client, forwarder: Forwarder, gone: Callable[[float], None]
) -> None:
    with Client(forwarder.url, client._token) as here, here.drive() as drive:
        episode = drive.practise(REQUEST).id
        gone(15)
        assert drive.step(episode, 1, GAS).seq == 1
        drive.abort_episode(episode)


_PLAIN = b"HTTP/1.1 %d Some\r\nContent-Length: 4\r\nConnection: close\r\n\r\nGone"


@pytest.mark.parametrize("gone", [None], indirect=True)
@pytest.mark.parametrize("status", [200, 302, 401, 404, 500, 503])
def test_what_stands_in_for_a_service_that_is_started_again_is_waited_out(
    client: Client, forwarder: Forwarder, gone: Callable[..., None], status: int
) -> None:
    with Client(forwarder.url, client._token) as here:
        with here.drive() as drive:
            episode = drive.practise(REQUEST).id
            gone(15, _PLAIN % status)
            assert drive.step(episode, 1, GAS).seq == 1
        gone(15, _PLAIN % status)
        with here.drive() as again:
            assert again.step(episode, 2, GAS).seq == 2
            again.abort_episode(episode)


@pytest.mark.parametrize("gone", [None], indirect=True)
@pytest.mark.parametrize(
    ("problem", "status", "error"),
    [("unauthenticated", 401, AuthenticationError), ("protocol-version", 426, NotOfferedError)],
)
def test_a_service_that_comes_back_and_says_no_is_believed(
    client: Client, forwarder: Forwarder, gone: Callable[..., None], problem: str, status: int, error: type[Exception]
) -> None:
    body = json.dumps({"type": f"/problems/{problem}", "title": "No", "status": status, "detail": "no"}).encode()
    head = f"HTTP/1.1 {status} No\r\nContent-Type: application/problem+json\r\nContent-Length: {len(body)}\r\n\r\n"
    with Client(forwarder.url, client._token) as here, here.drive() as drive:
        episode = drive.practise(REQUEST).id
        gone(15, head.encode() + body)
        with pytest.raises(error):
            drive.step(episode, 1, GAS)
    client.abort_episode(episode)


def test_a_drive_begins_while_a_known_service_is_started_again(
    client: Client, forwarder: Forwarder, gone: Callable[[float], None]
) -> None:
    with Client(forwarder.url, client._token) as here:
        here.ready()
        gone(15)
        with here.drive() as drive:
            drive.abort_episode(drive.practise(REQUEST).id)


def test_a_bad_token_is_told_at_the_handshake(service: LocalService) -> None:
    with Client(service.url, "nobody's") as client, pytest.raises(AuthenticationError):
        client.drive()


def test_nobody_at_the_url_is_told(service: LocalService) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with Client(f"http://127.0.0.1:{port}", "t", patience=0.1) as client, pytest.raises(ServiceUnreachableError):
        client.drive()


@pytest.mark.parametrize("status", [200, 403, 404, 426, 501])
def test_a_service_without_the_socket_is_driven_over_http(status: int) -> None:
    class Old(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(status)
            self.send_header("Content-Length", "0")
            self.end_headers()

        def log_message(self, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Old) as server:
        thread = threading.Thread(target=server.handle_request)
        thread.start()
        with Client(f"http://127.0.0.1:{server.server_port}", "t") as client, pytest.raises(NotOfferedError):
            client.drive()
        thread.join(120)


def test_json_clients_and_injected_transports_use_http() -> None:
    for client in (Client(binary=False), Client(transport=httpx.MockTransport(lambda request: httpx.Response(500)))):
        with client, pytest.raises(NotOfferedError):
            client.drive()
