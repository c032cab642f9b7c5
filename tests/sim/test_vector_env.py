"""The batch against the single environment: the same bytes, whatever is drawn, driven, or shared among threads."""

import dataclasses
import subprocess
import sys

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from wrongturn_judge import THRESHOLDS, JudgeGeometry, judge
from wrongturn_networks import load_suite, load_town
from wrongturn_protocol import DIRECTIONS, Flag, Traffic
from wrongturn_sim import (
    EpisodeAlreadyFinishedError,
    EpisodeNotStartedError,
    InvalidActionError,
    TrialNotAloneError,
    WrongturnSimEnv,
    WrongturnVectorEnv,
)
from wrongturn_sim.fleet import fleet

ID = "wrongturn_sim:WrongturnSim-v0"
PICTURES = ["camera", "segmentation"]


def drawn_actions(count, steps, seed=3):
    """(steps, count, 3): some wander off, some brake to a stand, some go straight on and reach an exit."""
    random = np.random.default_rng(seed)
    actions = np.zeros((steps, count, 3), np.float32)
    bias = random.choice([0.0, 0.0, -0.3, 0.2], count)
    actions[..., 0] = np.clip(bias + random.normal(0, 0.2, (steps, count)) * (random.random(count) < 0.5), -1, 1)
    actions[..., 1] = random.uniform(0.1, 0.9, (steps, count))
    stops = np.where(random.random(count) < 0.4, random.integers(5, 40, count), steps)
    actions[..., 2] = np.arange(steps)[:, None] > stops
    return actions


def alone(actions, seed, mode, **arguments):
    """Return what single environments give under the same autoreset mode, a list of steps for each."""
    env = WrongturnSimEnv(**arguments)
    turns = []
    for i in range(actions.shape[1]):
        observation, info = env.reset(seed=seed + i)
        mine = [(observation, 0.0, False, False, info, None)]
        over = False
        for action in actions[:, i]:
            if over:
                observation, info = env.reset()
                mine.append((observation, 0.0, False, False, info, None))
                over = False
                continue
            observation, reward, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            final = None
            if over:
                final = (observation, info, env.episode.trajectory.sha256, env.episode.actions_sha256)
                if mode is AutoresetMode.SAME_STEP:
                    observation, info = env.reset()
                    over = False
            mine.append((observation, reward, terminated, truncated, info, final))
        turns.append(mine)
    return turns


def same(observation, batch, i):
    assert set(observation) == set(batch)
    for name, array in observation.items():
        assert array.dtype == batch[name].dtype, name
        assert array.shape == batch[name].shape[1:], name
        assert array.tobytes() == batch[name][i].tobytes(), name


def compare(actions, seed=5, mode=AutoresetMode.NEXT_STEP, threads=1, **arguments):
    """Drive both and compare every byte; the verdicts that fell."""
    count = actions.shape[1]
    turns = alone(actions, seed, mode, **arguments)
    envs = WrongturnVectorEnv(count, threads=threads, autoreset_mode=mode, **arguments)
    assert envs.metadata["autoreset_mode"] is mode
    observation, infos = envs.reset(seed=seed)
    verdicts = []
    for i in range(count):
        same(turns[i][0][0], observation, i)
        assert infos["trial"][i] == turns[i][0][4]["trial"]
    for step, action in enumerate(actions, start=1):
        observation, rewards, terminated, truncated, infos = envs.step(action)
        for i in range(count):
            expected = turns[i][step]
            same(expected[0], observation, i)
            assert np.float64(expected[1]).tobytes() == rewards[i].tobytes()
            assert (expected[2], expected[3]) == (terminated[i], truncated[i])
            final = expected[5]
            if final is None:
                assert not infos.get("_verdict", np.zeros(count, bool))[i]
                assert bool(infos.get("_trial", np.zeros(count, bool))[i]) == ("trial" in expected[4])
                continue
            verdicts.append(final[1]["verdict"])
            if mode is AutoresetMode.SAME_STEP:
                same(final[0], {name: array[None] for name, array in infos["final_obs"][i].items()}, 0)
                assert infos["final_info"]["verdict"][i] == final[1]["verdict"]
                assert infos["trial"][i] == expected[4]["trial"]
            else:
                record = envs.episode(i)
                assert record.outcome.model_dump(mode="json", exclude_none=True) == final[1]["outcome"]
                assert infos["outcome"][i] == final[1]["outcome"]
                assert infos["verdict"][i] == final[1]["verdict"]
                assert record.trajectory.sha256 == final[2]
                assert record.actions_sha256 == final[3]
    envs.close()
    return verdicts


@pytest.mark.parametrize("track", ["state", "privileged"])
@pytest.mark.parametrize("fault", ["none", "infeasible", "omission"])
@pytest.mark.parametrize("town", ["junctions", "Town01"])
def test_random_drives_are_those_of_the_single_environment(town, fault, track):
    verdicts = compare(drawn_actions(12, 150), town=town, fault=fault, track=track, threads=3)
    assert len(verdicts) > 12
    assert len(set(verdicts)) > 2


@pytest.mark.parametrize("track", PICTURES)
def test_pictures_are_those_of_the_single_environment(track):
    arguments = {"town": "Town01", "track": track, "weather": ["HardRainNoon", "ClearSunset", "ClearNoon"]}
    assert compare(drawn_actions(5, 60), threads=2, **arguments)


def test_pictures_of_another_camera_and_size():
    from wrongturn_sim.camera import Camera

    envs = WrongturnVectorEnv(3, "junctions", "segmentation", camera=Camera(width=48, height=16), threads=2)
    env = WrongturnSimEnv("junctions", "segmentation", camera=Camera(width=48, height=16))
    assert envs.single_observation_space == env.observation_space
    seen, _ = envs.reset(seed=4)
    assert seen in envs.observation_space
    for i in range(3):
        same(env.reset(seed=4 + i)[0], seen, i)


def test_the_next_episode_begins_in_the_same_step():
    assert compare(drawn_actions(8, 120), mode=AutoresetMode.SAME_STEP, town="Town02", track="privileged", threads=2)


def test_trials_of_a_suite():
    assert compare(drawn_actions(6, 80), suite="smoke@2", track="state")


def test_trials_of_a_draw_with_their_own_windows(drive):
    draw = load_suite("wrong-command@2").draw("a secret of this test")
    driven = [drive(trial) for trial in draw.episodes[:8]]
    assert len({episode.trial.window for episode in driven}) == 8
    envs = WrongturnVectorEnv(len(driven), "Town01", "privileged", autoreset_mode="Disabled")
    envs.reset(options={"trial": [episode.trial for episode in driven]})
    inputs = [[row[8:11] for row in episode.trajectory.rows[1::2]] for episode in driven]
    compared = 0
    while compared < len(driven):
        actions = np.array([given[min(int(k), len(given) - 1)] for given, k in zip(inputs, envs.steps, strict=True)])
        _, _, terminated, truncated, _ = envs.step(actions)
        ended = terminated | truncated
        for i in np.flatnonzero(ended):
            assert envs.episode(i).trajectory.to_json() == driven[i].trajectory.to_json()
            assert envs.episode(i).outcome == driven[i].outcome
            compared += 1
        if ended.any():
            envs.reset(options={"trial": [episode.trial for episode in driven], "reset_mask": ended})


def test_a_fault_that_is_not_compiled(monkeypatch):
    monkeypatch.setattr(fleet, "_COMPILED", {})
    for fault in ("none", "infeasible", "omission"):
        compare(drawn_actions(6, 60), town="junctions", fault=fault, track="privileged")


def test_drives_by_every_exit_come_to_the_same(make_trial, drive):
    town = load_town("junctions")
    for name, approach in town.approaches.items():
        driven = [
            drive(make_trial(name, "omission" if k % 2 else "none", seed=k), direction)
            for k, direction in enumerate(DIRECTIONS)
            if direction in approach.exits
        ]
        count = len(driven)
        envs = WrongturnVectorEnv(count, "junctions", autoreset_mode="Disabled")
        envs.reset(options={"trial": [episode.trial for episode in driven]})
        inputs = [[row[8:11] for row in episode.trajectory.rows[1::2]] for episode in driven]
        done = np.zeros(count, bool)
        while not done.all():
            # Those that ended drive their trial once more, since all are stepped.
            actions = np.array(
                [given[min(int(k), len(given) - 1)] for given, k in zip(inputs, envs.steps, strict=True)]
            )
            _, _, terminated, truncated, _ = envs.step(actions)
            ended = terminated | truncated
            for i in np.flatnonzero(ended & ~done):
                record = envs.episode(i)
                assert record.trajectory.to_json() == driven[i].trajectory.to_json()
                assert record.outcome == driven[i].outcome
                assert record.actions_sha256 == driven[i].actions_sha256
            done |= ended
            if ended.any():
                envs.reset(options={"trial": [episode.trial for episode in driven], "reset_mask": ended})


def test_time_runs_out(make_trial, drive):
    """A car that creeps: the verdict is the same, and it is the time that ended it."""
    trial = make_trial()
    envs = WrongturnVectorEnv(1, "junctions", trial=trial)
    single = WrongturnSimEnv(trial=trial)
    seen, _ = envs.reset()
    single.reset()
    over = False
    while not over:
        speed = seen["speed"][0, 0]
        action = np.float32([[0.0, 0.2 if speed < 0.15 else 0.0, 0.5 if speed > 0.2 else 0.0]])
        seen, _, terminated, truncated, _ = envs.step(action)
        _, _, *ended, _ = single.step(action[0])
        assert ended == [terminated[0], truncated[0]]
        over = any(ended)
    assert truncated[0]
    assert envs.steps[0] == 600
    assert envs.episode(0).trajectory.to_json() == single.episode.trajectory.to_json()
    assert envs.episode(0).outcome == single.episode.outcome


def policies(trial):
    """(5, steps, 3): stop and go, over the kerb and back, into the oncoming lane, a stop, and a stop over there."""
    steps = np.arange(610)
    actions = np.zeros((5, len(steps), 3), np.float32)
    actions[:, :, 1] = 0.3
    actions[0, :, 2] = (steps // 25) % 2 == 1
    actions[1, :, 0] = np.select([steps < 6, steps < 14, steps < 20], [0.12, -0.12, 0.12], 0.0)
    actions[2, :, 0] = np.select([steps < 14, steps < 28], [-0.14, 0.14], 0.0)
    actions[3, :, 2] = steps > 12
    actions[4, :, 0] = np.select([steps < 12, steps < 24], [-0.14, 0.14], 0.0)
    actions[4, :, 2] = steps > 14
    return actions


def test_lengths_and_stops_have_the_same_bytes(make_trial):
    """What the judge sums up along a drive is the same in a batch, to the last bit."""
    seen = set()
    for approach in sorted(load_town("junctions").approaches):
        trial = make_trial(approach)
        actions = policies(trial)
        envs = WrongturnVectorEnv(5, "junctions", trial=trial, autoreset_mode=AutoresetMode.DISABLED)
        envs.reset()
        for i in range(5):
            envs.reset(options={"reset_mask": np.arange(5) == i})
            single = WrongturnSimEnv(trial=trial)
            single.reset()
            for step in range(actions.shape[1]):
                _, _, *ended, _ = single.step(actions[i, step])
                envs._fleet.step(actions[:, step], np.arange(5) == i)
                if any(ended):
                    break
            outcome = single.episode.outcome
            assert outcome is not None
            assert envs.episode(i).outcome.model_dump_json() == outcome.model_dump_json()
            assert envs.episode(i).trajectory.to_json() == single.episode.trajectory.to_json()
            names = ("kerb_bite_m", "opposed_lane_m", "first_stop_s", "over_line_m")
            seen |= {name for name in names if getattr(outcome, name)}
            seen |= {outcome.verdict, (outcome.verdict, outcome.flags, outcome.opposed_lane_m < 10.0)}
    assert {"kerb_bite_m", "opposed_lane_m", "first_stop_s", "stopped_before_junction"} <= seen
    assert ("stopped_before_junction", (Flag.OPPOSED_LANE,), True) in seen


def test_a_drive_goes_on_past_its_verdict(make_trial, drive):
    driven = drive(make_trial())
    actions = np.array([row[8:11] for row in driven.trajectory.rows[1::2]], np.float32)
    envs = WrongturnVectorEnv(2, "junctions", trial=driven.trial, drive_on=70.05)
    envs.reset()
    at_verdict = len(driven.trajectory.rows)
    for step in range(701):
        action = actions[step] if step < len(actions) else np.float32([0.3, 0.2, 0.0])
        _, _, terminated, truncated, infos = envs.step(np.stack([action, np.float32([0.0, 0.0, 1.0])]))
        assert not terminated.any()
        assert truncated.all() == (step == 700)
    assert infos["verdict"].tolist() == [driven.outcome.verdict, "not_engaged"]
    records = [envs.episode(i) for i in range(2)]
    assert [len(record.trajectory.rows) for record in records] == [1402, 1402]
    assert records[0].trajectory.rows[:at_verdict] == driven.trajectory.rows
    assert records[0].outcome == driven.outcome
    town = load_town("junctions")
    for record in records:
        geometry = JudgeGeometry.of(town, driven.trial)
        assert judge(record.trajectory, geometry) == record.outcome
        patient = dataclasses.replace(THRESHOLDS, wait_time=65.0, time_limit=70.0)
        later = judge(record.trajectory, geometry, patient)
        assert later.verdict == record.outcome.verdict
    assert later.time > 65.0


def test_a_drive_that_ends_before_its_verdict_has_none(make_trial):
    envs = WrongturnVectorEnv(1, "junctions", trial=make_trial(), drive_on=1.0, autoreset_mode=AutoresetMode.SAME_STEP)
    envs.reset(seed=1)
    for _ in range(10):
        *_, truncated, infos = envs.step(np.zeros((1, 3), np.float32))
    assert truncated[0]
    assert "verdict" not in infos["final_info"]


@pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf")])
def test_a_drive_goes_on_for_a_positive_time(seconds):
    with pytest.raises(ValueError, match="drive_on"):
        WrongturnVectorEnv(1, "junctions", drive_on=seconds)


def test_ends_of_several_kinds_go_together_in_gymnasiums_own_vector_environments(make_trial, drive):
    infos = {}
    for i, braked in enumerate((False, True)):
        episode = drive(make_trial())
        env = WrongturnSimEnv(trial=episode.trial)
        env.reset()
        info = {}
        for row in episode.trajectory.rows[1::2] * 2:
            if not info:
                *_, info = env.step(np.float32((0, 0, 1) if braked else row[8:11]))
        infos = gymnasium.vector.SyncVectorEnv([lambda env=env: env] * 2)._add_info(infos, info, i)
    assert infos["outcome"]["_exit"].tolist() == [True, False]
    assert infos["verdict"][1] == "not_engaged"


def test_gymnasium_makes_it():
    envs = gymnasium.make_vec(ID, num_envs=3, town="junctions", track="privileged", threads=2)
    assert isinstance(envs.unwrapped, WrongturnVectorEnv)
    assert envs.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    first, infos = envs.reset(seed=1)
    assert infos["_trial"].all()
    assert first in envs.observation_space
    seen, *_ = envs.step(envs.action_space.sample() * 0)
    assert (seen["pose"] != first["pose"]).any()
    again, _ = envs.reset(seed=[1, 2, 3])
    for name, array in first.items():
        assert array.tobytes() == again[name].tobytes()
    envs.close()


def test_views_are_written_over_where_no_copy_is_wanted():
    envs = WrongturnVectorEnv(2, "junctions", copy=False)
    seen, _ = envs.reset(seed=1)
    before = seen["speed"].copy()
    envs.step(np.tile(np.float32([0, 0, 1]), (2, 1)))
    assert (seen["speed"] < before).all()


def test_a_reset_of_some_leaves_the_others_alone():
    envs = WrongturnVectorEnv(3, "Town01", track="privileged", autoreset_mode="Disabled")
    first, _ = envs.reset(seed=1)
    envs.step(np.zeros((3, 3), np.float32))
    seen, infos = envs.reset(options={"reset_mask": np.array([True, False, False])})
    assert infos["_trial"].tolist() == [True, False, False]
    assert (seen["pose"][0] != first["pose"][0]).any()
    assert envs.steps.tolist() == [0, 1, 1]


class Learned:
    """Refuses as a torch tensor that requires a gradient."""

    def __array__(self, *_, **__):
        raise RuntimeError("Can't call numpy() on Tensor that requires grad.")


def test_what_cannot_be_done_says_why(make_trial):
    envs = WrongturnVectorEnv(2, "junctions", autoreset_mode="Disabled")
    still = np.zeros((2, 3), np.float32)
    with pytest.raises(EpisodeNotStartedError):
        envs.step(still)
    with pytest.raises(ValueError, match="begun no trial"):
        envs.episode(0)
    envs.reset(seed=1)
    for action in (None, "left", still[0], np.zeros((3, 3)), [["0", "0.5", "0"]] * 2, still + 0j, Learned()):
        with pytest.raises(InvalidActionError, match="actions: give"):
            envs.step(action)
    for field, (k, value) in {"steer": (0, -1.1), "throttle": (1, -0.1), "brake": (2, np.nan)}.items():
        bad = still.copy()
        bad[1, k] = value
        with pytest.raises(InvalidActionError, match=rf"actions\[1\]\.{field}"):
            envs.step(bad)
    assert envs.steps.tolist() == [0, 0]
    with pytest.raises(TrialNotAloneError, match="town"):
        envs.reset(options={"trial": make_trial(town="Town01")})
    crowded = make_trial().model_copy(update={"traffic": Traffic(vehicles=3)})
    with pytest.raises(TrialNotAloneError, match="traffic"):
        envs.reset(options={"trial": crowded})
    with pytest.raises(ValueError, match="seed"):
        envs.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match="reset_mask"):
        envs.reset(options={"reset_mask": np.zeros(2, bool)})
    ended = [False]
    while not any(ended):
        _, _, ended, _, _ = envs.step(np.tile(np.float32([0, 0, 1]), (2, 1)))
    with pytest.raises(EpisodeAlreadyFinishedError, match="reset_mask"):
        envs.step(still)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"num_envs": 0}, "num_envs"),
        ({"num_envs": True}, "num_envs"),
        ({"num_envs": "3"}, "num_envs"),
        ({"weather": "Foggy"}, "weather: 'Foggy' is unknown; give one of ClearNoon"),
        ({"threads": 0}, "threads"),
        ({"render_mode": "human"}, "render_mode"),
        ({"autoreset_mode": "Sometimes"}, "Sometimes"),
        ({"weather": []}, "weather"),
    ],
)
def test_what_cannot_be_made_says_why(arguments, named):
    with pytest.raises(ValueError, match=named):
        WrongturnVectorEnv(**{"num_envs": 2, "town": "junctions", **arguments})


def test_pictures_are_those_of_single_environments():
    envs = WrongturnVectorEnv(2, "junctions", fault="omission", autoreset_mode="Disabled", render_mode="rgb_array")
    with pytest.raises(EpisodeNotStartedError):
        envs.render()
    singles = [WrongturnSimEnv("junctions", fault="omission", render_mode="rgb_array") for _ in range(2)]
    envs.reset(seed=4)
    for i, env in enumerate(singles):
        env.reset(seed=4 + i)
    ended = np.zeros(2, bool)
    for step in range(60):
        if step in {0, 1, 30, 59}:
            for env, picture in zip(singles, envs.render(), strict=True):
                np.testing.assert_array_equal(env.render(), picture)
        _, _, ended, _, _ = envs.step([(0.0, 0.6, 0.0)] * 2)
        for env in singles:
            env.step((0.0, 0.6, 0.0))
        if ended.any():
            break
    assert ended.any()
    for env, picture in zip(singles, envs.render(), strict=True):
        np.testing.assert_array_equal(env.render(), picture)
    with pytest.raises(ValueError, match="render_mode: pictures are drawn from the record"):
        WrongturnVectorEnv(2, "junctions", record=False, render_mode="rgb_array")


def test_it_needs_no_sumo():
    code = (
        "import sys; sys.modules['libsumo'] = None\n"
        "import numpy, wrongturn_sim\n"
        "envs = wrongturn_sim.WrongturnVectorEnv(2, 'junctions', 'privileged')\n"
        "envs.reset(seed=1); envs.step(numpy.zeros((2, 3)))\n"
        "env = wrongturn_sim.WrongturnSimEnv('junctions')\n"
        "env.reset(seed=1); env.step(numpy.zeros(3))\n"
        "assert not any(name.startswith('libsumo.') for name in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
