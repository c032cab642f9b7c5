"""The environment over the wire, against the service in memory."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from client_fake_service import FakeService

from wrongturn_protocol import Command, Fault, FaultKind, JunctionType, Start, Trial

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


def test_without_a_token_an_agent_for_practice_is_registered_once(fake: FakeService) -> None:
    env = _make(fake)
    env.reset()
    env.reset()
    env.close()
    assert fake.paths("POST").count("/v1/agents") == 1
    assert fake.requests[-1].headers["authorization"] == "Bearer secret"


def test_of_several_weathers_each_trial_has_one(fake: FakeService) -> None:
    env = _make(fake, token="t", weather=["WetNoon", "ClearSunset"])
    for seed in range(20):
        env.reset(seed=seed)
    assert {request["weather"] for request in fake.practice} == {"WetNoon", "ClearSunset"}


@pytest.mark.parametrize("options", [{"task": "cruise", "journeys": {"lateral": 0.1}}, {"trial": TRIAL}])
def test_what_works_in_process_only_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"{list(options)[-1]}: "):
        _make(FakeService(), token="t", **options)


def test_only_approaches_that_admit_the_fault_are_drawn(fake: FakeService) -> None:
    env = _make(fake, token="t", fault="infeasible")
    for seed in range(10):
        env.reset(seed=seed)
    assert {request["approach"] for request in fake.practice} == {"J1-S"}
    with pytest.raises(ValueError, match="no such approach of Town01"):
        _make(fake, token="t", fault="infeasible", route=3).reset()


def test_journeys_are_practised_by_their_task(fake: FakeService) -> None:
    _make(fake, token="t", task="navigation").reset(seed=1)
    _make(fake, token="t", task="straight", town="Town02", approach="J1-S").reset(seed=1)
    asked = [(request["town"], request["task"], request.get("approach")) for request in fake.practice]
    assert asked == [("Town01", "navigation", None), ("Town02", "straight", "J1-S")]
    assert not fake.paths("GET"), "no approach had to be looked up"


def test_an_episode_that_is_left_is_given_up(fake: FakeService) -> None:
    env = _make(fake, token="t", approach="J1-S")
    env.reset()
    env.step(ACTION)
    env.reset()
    assert fake.aborted == ["ep0"]
    for _ in range(3):
        env.step(ACTION)
    env.close()
    assert fake.aborted == ["ep0"], "the second came to its end"


def test_traffic_is_asked_for(fake: FakeService) -> None:
    _make(fake, token="t", approach="J1-E", traffic={"vehicles": 20}).reset()
    assert fake.practice[0]["traffic"] == {"vehicles": 20, "pedestrians": 0}
