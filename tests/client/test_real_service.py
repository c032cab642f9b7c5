"""The client against ``wrongturn serve``."""

import os
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from wrongturn_client import Action, AuthenticationError, Client, EvaluationFinishedError, LocalService, NotFoundError
from wrongturn_protocol import EpisodeState, EvaluationState, PracticeRequest, Track
from wrongturn_protocol.observations import Observation

BRAKE = Action(steer=0, throttle=0, brake=1)


class Parked:
    """Brakes, and does what it is told at its ``at``-th decision."""

    def __init__(self, at: int = -1, do: Any = None) -> None:
        self.decisions = 0
        self.at = at
        self.do = do

    def reset(self, observation_space: Any) -> None:
        pass

    def act(self, observation: Observation) -> Action:
        self.decisions += 1
        if self.decisions == self.at:
            self.do()
        return BRAKE


def _token(url: str, name: str, track: Track = Track.PRIVILEGED) -> str:
    with Client(url) as client:
        return client.register(name, track).token


def test_the_public_calls(service: LocalService) -> None:
    with Client(service.url) as client:
        assert client.live()
        assert client.ready()
        suites = {suite.id: suite for suite in client.suites()}
        suite = client.suite("smoke@2")
        assert suite.model_dump(exclude={"cells"}) == suites["smoke@2"].model_dump()
        assert len(suite.cells) == suite.trials == 6
        trials = client.trials("smoke@2")
        assert len(trials) == suites["smoke@2"].trials
        towns = {town.name: town for town in client.towns()}
        town = client.town(trials[0].town)
        assert town.sha256 == towns[town.name].sha256
        assert trials[0].approach in {approach.id for approach in town.approaches}
        agent = client.register("public", Track.PRIVILEGED)
        assert client.agent(agent.id) in client.agents(everybody=True)
        assert "smoke@2" in {board.suite for board in client.leaderboards()}
        assert client.leaderboard("smoke@2").suite == "smoke@2"
        with pytest.raises(NotFoundError, match="smoke@2"):
            client.suite("nothing@1")
        with pytest.raises(AuthenticationError):
            client.create_evaluation("smoke@2")


def test_tokens_turn_and_end(service: LocalService) -> None:
    with Client(service.url) as client:
        agent = client.register("turning", Track.PRIVILEGED)
    with Client(service.url, agent.token) as client:
        token = client.rotate_token(agent.id).token
        with pytest.raises(AuthenticationError):
            client.create_evaluation("smoke@2")
    with Client(service.url, token) as client:
        client.revoke_token(agent.id)
        with pytest.raises(AuthenticationError):
            client.create_evaluation("smoke@2")


def test_an_evaluation_from_beginning_to_end(service: LocalService) -> None:
    told: list[tuple[int, int]] = []
    with Client(service.url, _token(service.url, "parked")) as client:
        detail = client.evaluate(Parked(), "smoke@2", progress=lambda done, of: told.append((done, of)))
        assert detail.state is EvaluationState.FINISHED
        assert told == [(n, 12) for n in range(13)]
        assert detail.metrics is not None
        assert detail.metrics.unsafe.trials == 6
        with pytest.raises(EvaluationFinishedError):
            client.next_episode(detail.id)
        (entry,) = (one for one in client.leaderboard("smoke@2").entries if one.agent.name == "parked")
        assert not entry.eligible


def test_json_and_msgpack_say_the_same(service: LocalService) -> None:
    token = _token(service.url, "twice")
    seen: list[list[Any]] = []
    trajectories = []
    for binary in (True, False):
        with Client(service.url, token, binary=binary) as client:
            trial = client.trials("smoke@2")[0].id
            begin = client.practise(PracticeRequest(suite="smoke@2", trial=trial, track=Track.PRIVILEGED))
            replies = []
            for seq in range(1, 500):
                replies.append(client.step(begin.id, seq, Action(steer=0.1, throttle=0.6, brake=0)))
                if replies[-1].terminated or replies[-1].truncated:
                    break
            assert replies[-1].verdict is not None
            detail = client.episode(begin.id)
            assert detail.state is EpisodeState.FINISHED
            assert detail.outcome is not None
            assert detail.outcome.verdict is replies[-1].verdict
            trajectories.append(client.trajectory(begin.id))
            seen.append([begin.observation, *(reply.observation for reply in replies)])
    assert trajectories[0] == trajectories[1]
    assert len(seen[0]) == len(seen[1])
    for one, other in zip(*seen, strict=True):
        assert all(np.array_equal(one[key], other[key]) for key in one)


def test_an_interrupted_evaluation_goes_on(service: LocalService) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    token = _token(service.url, "interrupted")
    with Client(service.url, token) as client:
        evaluation = client.create_evaluation("smoke@2").id
        with pytest.raises(KeyboardInterrupt):
            client.evaluate(Parked(60, interrupt), "smoke@2", evaluation=evaluation)
        (left,) = client.open_episodes(evaluation)
        assert left.seq > 0
    with Client(service.url, token) as client:
        detail = client.evaluate(Parked(), "smoke@2", evaluation=evaluation)
    assert detail.state is EvaluationState.FINISHED
    assert detail.metrics is not None
    assert detail.metrics.verdicts["none"].get("aborted", 0) == 0  # type: ignore[call-overload]


@pytest.mark.soak  # tests/faults kills a service, a simulator and a client in CI
def test_a_service_that_is_killed_and_started_again_costs_nothing(tmp_path: Path) -> None:
    database = f"sqlite+aiosqlite:///{tmp_path / 'wrongturn.db'}"
    with ExitStack() as stack:
        first = stack.enter_context(LocalService(database=database))

        def restart() -> None:
            os.kill(first.pid, signal.SIGKILL)
            first.stop()
            stack.enter_context(LocalService(database=database, port=int(first.url.rpartition(":")[2])))

        with Client(first.url, _token(first.url, "patient")) as client:
            detail = client.evaluate(Parked(60, restart), "smoke@2")
    assert detail.state is EvaluationState.FINISHED
    assert detail.finished == detail.trials == 12
    assert detail.metrics is not None
    assert all(not counts.get("aborted") for counts in detail.metrics.verdicts.values())  # type: ignore[call-overload]
