"""Practice among other road users, over HTTP."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from service_harness import GAS, Agent, RunningService, expect

from wrongturn_networks import draw_trial, load_town
from wrongturn_protocol import FaultKind, Track, Traffic
from wrongturn_protocol.observations import decode
from wrongturn_sim import Episode, JudgeGeometry, Trajectory, judge

CROWD = {"vehicles": 30, "pedestrians": 15}
WHERE = {"town": "junctions", "approach": "J1-S", "seed": 1}


def test_as_in_process_and_the_record_alone_gives_the_verdict(agent: Agent) -> None:
    town = load_town("junctions")
    trial = draw_trial(town, "J1-S", FaultKind.NONE, 1, traffic=Traffic(vehicles=40))
    episode = Episode(trial, Track.PRIVILEGED)
    reply = agent.practise(**WHERE, track="privileged", traffic={"vehicles": 40})
    name, seq, observation = reply["id"], 0, episode.reset()
    met = 0
    while True:
        got = decode(reply["observation"], Track.PRIVILEGED)
        assert all(np.array_equal(got[key], array) for key, array in observation.items())
        met = max(met, int(got["road_users_count"][0]))
        if episode.outcome is not None:
            break
        seq += 1
        observation = episode.step(*GAS.values()).observation
        reply = expect(agent.step(name, seq, GAS), 200)
    assert met > 10
    assert reply["verdict"] == "collision"
    record = agent.trajectory(name)
    assert record == episode.trajectory.to_json()
    assert judge(Trajectory.from_json(record), JudgeGeometry.of(town, trial)) == episode.outcome


@pytest.mark.soak  # tests/service/test_recovery.py kills one that is alone
def test_a_simulator_that_is_killed_among_others(tmp_path: Path) -> None:
    service = RunningService(tmp_path / "wrongturn.db", simulators=1)
    try:
        with service.agent() as agent:
            trajectories = []
            for kill in (False, True):
                # Another drive in between, so that the replay finds a simulator that has driven.
                agent.drive(agent.practise(**WHERE, traffic=CROWD | {"vehicles": 5})["id"])
                episode = agent.practise(**WHERE, track="privileged", traffic=CROWD)["id"]
                for seq in range(1, 9):
                    if kill and seq == 5:
                        (pid,) = service.simulators()
                        os.kill(pid, signal.SIGKILL)
                    expect(agent.step(episode, seq, GAS), 200)
                agent.drive(episode, GAS, 9)
                trajectories.append(agent.trajectory(episode))
            assert trajectories[0] == trajectories[1]
            assert b'"road_users"' in trajectories[0]
        assert service.stop() == 0
    finally:
        if not service.process.stdout.closed:  # type: ignore[union-attr]
            service.kill()
