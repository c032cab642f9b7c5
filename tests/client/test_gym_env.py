"""The environment over the wire, against the service in memory."""

import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from client_fake_service import FakeService, problem
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

from wrongturn_client import Action, InvalidActionError, NotFoundError
from wrongturn_protocol import Command, Fault, FaultKind, JunctionType, ProblemType, Start, Track, Trial
from wrongturn_protocol.observations import action_space, observation_space

ACTION = np.array([0.1, 0.5, 0.0], np.float32)

TRIAL = Trial(
    id="Town01.J3-S.none.s1",
    town="Town01",
    approach="J3-S",
    junction_type=JunctionType.CROSS,
    route=Command.LEFT,
    start=Start(distance=20, speed=0, lateral=0, yaw=0),
    fault=Fault(kind=FaultKind.NONE),
    seed=1,
)


def _make(service: FakeService, **options: Any) -> gymnasium.Env[Any, Any]:
    return gymnasium.make(
        "wrongturn_client:Wrongturn-v0", url="http://fake", transport=service.transport, track=service.track, **options
    )


@pytest.mark.parametrize("track", list(Track))
def test_spaces_are_the_tracks(track: Track) -> None:
    env = _make(FakeService(track=track), token="t")
    assert env.observation_space == observation_space(track)
    assert env.action_space == action_space()
    observation, info = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert info == {"trial": "t1", "town": "Town01"}
    for last in (False, False, True):
        observation, reward, terminated, truncated, info = env.step(ACTION)
        assert env.observation_space.contains(observation)
        assert (reward, terminated, truncated) == (1.5, last, False)
    assert info == {"verdict": "exit_route"}
    env.close()


def test_without_a_token_an_agent_for_practice_is_registered_once() -> None:
    service = FakeService()
    env = _make(service)
    env.reset()
    env.reset()
    env.close()
    assert service.paths("POST").count("/v1/agents") == 1
    assert service.requests[-1].headers["authorization"] == "Bearer secret"


def test_the_same_seed_asks_for_the_same_trials() -> None:
    asked = []
    for _ in range(2):
        service = FakeService()
        env = _make(service, token="t")
        env.reset(seed=5)
        for _ in range(5):
            env.reset()
        env.close()
        asked.append(service.practice)
    assert asked[0] == asked[1]
    assert len({request["seed"] for request in asked[0]}) == 6
    assert {request["approach"] for request in asked[0]} == {"J1-S", "J2-S"}


def test_of_several_weathers_each_trial_has_one() -> None:
    service = FakeService()
    env = _make(service, token="t", weather=["WetNoon", "ClearSunset"])
    for seed in range(20):
        env.reset(seed=seed)
    assert {request["weather"] for request in service.practice} == {"WetNoon", "ClearSunset"}


@pytest.mark.parametrize("options", [{"task": "cruise", "journeys": {"lateral": 0.1}}, {"trial": TRIAL}])
def test_what_works_in_process_only_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"{list(options)[-1]}: "):
        _make(FakeService(), token="t", **options)


def test_only_approaches_that_admit_the_fault_are_drawn() -> None:
    service = FakeService()
    env = _make(service, token="t", fault="infeasible")
    for seed in range(10):
        env.reset(seed=seed)
    assert {request["approach"] for request in service.practice} == {"J1-S"}
    with pytest.raises(ValueError, match="no such approach of Town01"):
        _make(service, token="t", fault="infeasible", route=3).reset()


def test_journeys_are_practised_by_their_task() -> None:
    service = FakeService()
    _make(service, token="t", task="navigation").reset(seed=1)
    _make(service, token="t", task="straight", town="Town02", approach="J1-S").reset(seed=1)
    asked = [(request["town"], request["task"], request.get("approach")) for request in service.practice]
    assert asked == [("Town01", "navigation", None), ("Town02", "straight", "J1-S")]
    assert not service.paths("GET"), "no approach had to be looked up"


def test_an_episode_that_is_left_is_given_up() -> None:
    service = FakeService()
    env = _make(service, token="t", approach="J1-S")
    env.reset()
    env.step(ACTION)
    env.reset()
    assert service.aborted == ["ep0"]
    for _ in range(3):
        env.step(ACTION)
    env.close()
    assert service.aborted == ["ep0"], "the second came to its end"


def test_a_suites_trial_is_practised() -> None:
    service = FakeService()
    _make(service, token="t", suite="smoke@2", trial="one").reset()
    _make(service, token="t", suite="smoke@2", trial="one").reset(options={"trial": "two"})
    assert [(request["suite"], request["trial"]) for request in service.practice] == [
        ("smoke@2", "one"),
        ("smoke@2", "two"),
    ]


@pytest.mark.parametrize(
    "options",
    [
        {"trial": "one"},
        {"suite": "smoke@2", "town": "Town01"},
        {"fault": "nothing"},
        {"task": "wander"},
        {"suite": "smoke@2", "task": "straight"},
        {"weather": "Fog"},
        {"traffic": {"vehicles": -1}},
        {"route": 9},
    ],
)
def test_names_that_do_not_go_together_are_refused_before_any_call(options: dict[str, Any]) -> None:
    service = FakeService()
    with pytest.raises(ValueError, match=r"trial|suite|nothing|wander|Fog|vehicles|9"):
        _make(service, **options)
    assert service.requests == []


@pytest.mark.parametrize(
    ("action", "named"),
    [([np.nan, 0, 0], "action.steer"), ([0, 2, 0], "action.throttle"), ([0, 0], "three numbers"), ("left", "three")],
)
def test_an_action_that_is_none_is_named(action: Any, named: str) -> None:
    env = _make(FakeService(), token="t", disable_env_checker=True).unwrapped
    env.reset()
    with pytest.raises(InvalidActionError, match=named):
        env.step(action)


@pytest.mark.parametrize("action", [Action(0.1, 0.5, 0.0), (0.1, 0.5, 0.0), [0.1, 0.5, 0.0], ACTION])
def test_an_action_may_be_an_action_an_array_a_tuple_or_a_list(action: Any) -> None:
    service = FakeService()
    env = _make(service, token="t")
    env.reset()
    env.step(action)
    np.testing.assert_allclose(service.seen["ep0"], [ACTION])


def test_a_step_before_the_reset_and_a_refusal() -> None:
    service = FakeService()
    env = _make(service, token="t").unwrapped
    with pytest.raises(ResetNeeded):
        env.step(ACTION)
    service.inject = lambda request: problem(ProblemType.UNKNOWN_TOWN, 404, "no town Oslo; there are Town01, Town02")
    with pytest.raises(NotFoundError, match="no town Oslo"):
        env.reset()


def test_traffic_is_asked_for() -> None:
    service = FakeService()
    _make(service, token="t", approach="J1-E", traffic={"vehicles": 20}).reset()
    assert service.practice[0]["traffic"] == {"vehicles": 20, "pedestrians": 0}


def test_importing_the_package_registers_it_in_any_order() -> None:
    code = "import wrongturn_client, gymnasium; gymnasium.make('wrongturn_client:Wrongturn-v0')"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_gymnasiums_checker_passes() -> None:
    class Same(FakeService):
        """The checker wants the same seed to give the same observation."""

        def observation(self, request: Any) -> dict[str, Any]:
            self.generator = np.random.default_rng(1)
            return super().observation(request)

    service = Same()
    env = _make(service, token="t")
    # The fake service draws nothing; the tests of a real one look at pictures.
    check_env(env.unwrapped, skip_render_check=True)
