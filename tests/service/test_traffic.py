"""Practice among other road users, over HTTP."""

import numpy as np
from service_harness import GAS, Agent, expect

from wrongturn_networks import draw_trial, load_town
from wrongturn_protocol import FaultKind, Track, Traffic
from wrongturn_protocol.observations import decode
from wrongturn_sim import Episode, JudgeGeometry, Trajectory, judge

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
