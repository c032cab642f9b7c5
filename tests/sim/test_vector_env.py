"""The batch in process: what it has beyond the contract of tests/environments."""

import dataclasses

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from wrongturn_judge import THRESHOLDS, JudgeGeometry, judge
from wrongturn_networks import load_suite, load_town
from wrongturn_protocol import DIRECTIONS, Flag
from wrongturn_sim import TrialNotAloneError, WrongturnSimEnv, WrongturnVectorEnv
from wrongturn_sim.camera import LOOKS, Camera


def test_pictures_of_other_cameras_and_another_size():
    cameras = [Camera(width=48, height=16, pitch=0.1 * i) for i in range(3)]
    for given in (cameras[0], cameras):
        envs = WrongturnVectorEnv(3, "junctions", "segmentation", camera=given, threads=2)
        seen, _ = envs.reset(seed=4)
        assert seen in envs.observation_space
        for i in range(3):
            env = WrongturnSimEnv("junctions", "segmentation", camera=given[i] if given is cameras else given)
            assert envs.single_observation_space == env.observation_space
            for name, array in env.reset(seed=4 + i)[0].items():
                assert array.tobytes() == seen[name][i].tobytes(), name
    with pytest.raises(ValueError, match="camera: there are 3; give one for all, or 2"):
        WrongturnVectorEnv(2, "junctions", "segmentation", camera=cameras)


def test_looks_between_two_weathers_are_chosen_by_seeds():
    def seen(**options):
        observed, infos = WrongturnVectorEnv(8, "junctions", "segmentation", **options).reset(seed=4)
        return observed["rgb"], [int(name.rsplit("s", 1)[1]) % 3 for name in infos["trial"]]

    looks = [LOOKS["ClearNoon"].mixed(LOOKS["HardRainNoon"], share) for share in (0.0, 0.5, 1.0)]
    alone = [seen(looks=[look])[0] for look in looks]
    assert np.array_equal(alone[::2], [seen(weather=name)[0] for name in ("ClearNoon", "HardRainNoon")])
    mixed, chosen = seen(looks=looks)
    assert len(set(chosen)) > 1
    assert np.array_equal(mixed, [alone[k][i] for i, k in enumerate(chosen)])
    with pytest.raises(ValueError, match="share: is nan; give 0 to 1"):
        looks[0].mixed(looks[2], float("nan"))


def test_trials_of_a_draw_with_their_own_windows(drive, same_in_a_batch):
    driven = [drive(trial) for trial in load_suite("wrong-command@3").draw("a secret of this test").episodes[:8]]
    assert len({episode.trial.window for episode in driven}) == 8
    same_in_a_batch(driven)


def test_drives_by_every_exit_come_to_the_same(make_trial, drive, same_in_a_batch):
    for name, approach in load_town("junctions").approaches.items():
        ways = [(k, direction) for k, direction in enumerate(DIRECTIONS) if direction in approach.exits]
        same_in_a_batch([drive(make_trial(name, "omission" if k % 2 else "none", seed=k), way) for k, way in ways])


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
        trial = make_trial(approach).model_copy(update={"watch": 3.3})
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
            names = ("kerb_bite_m", "opposed_lane_m", "first_stop_s", "over_line_m", "stop_past_line_m")
            seen |= {name for name in names if getattr(outcome, name)}
            seen |= {outcome.verdict, (outcome.verdict, outcome.flags, outcome.opposed_lane_m < 10.0)}
    assert {"kerb_bite_m", "opposed_lane_m", "first_stop_s", "stopped_before_junction"} <= seen
    assert ("stopped_before_junction", (Flag.OPPOSED_LANE, Flag.STOPPED_ACROSS), True) in seen


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


def test_views_are_written_over_where_no_copy_is_wanted():
    envs = WrongturnVectorEnv(2, "junctions", copy=False)
    seen, _ = envs.reset(seed=1)
    before = seen["speed"].copy()
    envs.step(np.tile(np.float32([0, 0, 1]), (2, 1)))
    assert (seen["speed"] < before).all()


def test_what_cannot_be_done_says_why(make_trial):
    envs = WrongturnVectorEnv(2, "junctions")
    with pytest.raises(ValueError, match="begun no trial"):
        envs.episode(0)
    envs.reset(seed=1)
    with pytest.raises(TrialNotAloneError, match="town"):
        envs.reset(options={"trial": make_trial(town="Town01")})


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"threads": 0}, "threads"),
        ({"copy": "no"}, "^copy: is 'no'; give True or False$"),
        ({"camera": "front"}, "^camera: is 'front'; give a wrongturn_sim.camera.Camera$"),
        ({"track": "camera", "backend": "metal"}, "^backend: is 'metal'; give cpu or cuda$"),
        *(({"track": "camera", "looks": bad}, "looks: give a list") for bad in (None, iter([]), ["ClearNoon"])),
        ({"drive_on": "long"}, "^drive_on: is 'long'; give seconds"),
        *(({"drive_on": seconds}, "drive_on") for seconds in (0.0, -1.0, float("nan"), float("inf"))),
        ({"own_traffic": True}, "^own_traffic: is True; give a FleetTraffic"),
        ({"record": False, "render_mode": "rgb_array"}, "render_mode: pictures are drawn from the record"),
    ],
)
def test_what_cannot_be_made_says_why(arguments, named):
    with pytest.raises(ValueError, match=named):
        WrongturnVectorEnv(**{"num_envs": 2, "town": "junctions", **arguments})


def test_a_trial_whose_beginning_was_interrupted_is_judged_as_ever(monkeypatch):
    first, second = load_suite("wrong-command@3").episodes[0], load_suite("wrong-command@3").episodes[-1]
    assert first.approach != second.approach

    def made():
        return WrongturnVectorEnv(1, track="privileged", suite="wrong-command@3", autoreset_mode="Disabled")

    def driven(envs, trial):
        envs.reset(seed=0, options={"trial": [trial]})
        over = [False]
        while not any(over):
            _, _, terminated, truncated, _ = envs.step([(0.0, 0.5, 0.0)])
            over = terminated | truncated
        return envs.episode(0).outcome

    def interrupted(*_):
        raise KeyboardInterrupt

    envs = made()
    expected = [driven(envs, first), driven(envs, second)]
    envs = made()
    with monkeypatch.context() as patched:
        patched.setattr(JudgeGeometry, "of", interrupted)
        with pytest.raises(KeyboardInterrupt):
            envs.reset(seed=0, options={"trial": [first]})
    assert [driven(envs, second), driven(envs, first)] == expected[::-1]
