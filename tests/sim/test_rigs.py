"""What a rig's agent sees and is told, and that it is the same drive."""

import math

import cv2
import numpy as np
import pytest

from wrongturn_networks import draw_trial, load_town
from wrongturn_networks.faults import available_faults
from wrongturn_protocol import DIRECTIONS, Command, Fault, FaultKind, Fork, Rig, RigCamera, Track, Trial
from wrongturn_protocol.observations import fields_of, observation_space, picture_of, text
from wrongturn_protocol.rigs import rig_of
from wrongturn_sim import Episode
from wrongturn_sim.camera import Camera
from wrongturn_sim.eyes import camera_of

TOWN = load_town("Town01")
PLAIN = {"width": 192, "height": 64, "fov": 2 * math.degrees(math.atan(96 / 107.4)), "horizon": 26}
TOLD = rig_of({"navigation": ["command", "next_command", "distance", "target_points", "sentence"]})
assert TOLD is not None


def rig(*cameras: dict, **more) -> Rig:
    made = rig_of({"cameras": cameras, **more})
    assert made is not None
    return made


def trial_of(kind: FaultKind = FaultKind.NONE, approach: str = "J3-S", seed: int = 4) -> Trial:
    return draw_trial(TOWN, approach, Fault(kind=kind), seed)


def drive(trial: Trial, sight, steps: int = 8, steer: float = 0.05, **options):
    episode = Episode(trial, sight, **options)
    seen = [episode.reset()]
    for _ in range(steps):
        step = episode.step(steer, 0.5, 0.0)
        seen.append(step.observation)
        if step.terminated or step.truncated:
            break
    return episode, seen


def same(one, other) -> bool:
    return len(one) == len(other) and all(
        np.array_equal(a[k], b[k]) for a, b in zip(one, other, strict=True) for k in b
    )


@pytest.mark.parametrize("kind", [FaultKind.NONE, FaultKind.NOISE, FaultKind.PITCH, FaultKind.DELAY])
def test_the_tracks_camera_as_a_rig_is_the_track(kind: FaultKind) -> None:
    segmentation = {**PLAIN, "name": "segmentation", "kind": "segmentation"}
    track, rigged = drive(trial_of(kind), Track.SEGMENTATION), drive(trial_of(kind), rig(PLAIN, segmentation))
    assert camera_of(RigCamera(**PLAIN)).packed() == pytest.approx(Camera().packed())
    assert same(rigged[1], track[1])
    assert rigged[0].trajectory.sha256 == track[0].trajectory.sha256


def test_twenty_decisions_a_second_are_the_same_drive() -> None:
    slow, _ = drive(trial_of(), Track.STATE, 100)
    fast, _ = drive(trial_of(), rig(rate=20), 200)
    assert slow.outcome is not None
    assert (fast.outcome, fast.trajectory.sha256) == (slow.outcome, slow.trajectory.sha256)
    late = drive(trial_of(FaultKind.DELAY), rig(rate=20), 40)[1]
    on_time = drive(trial_of(), rig(rate=20), 40)[1]
    assert late[-1]["speed"] == on_time[-1 - round(0.3 * 20)]["speed"]


def test_histories_rates_and_pictures_are_as_declared() -> None:
    eyes = rig({**PLAIN, "name": "now"}, {**PLAIN, "name": "past", "history": 3, "stride": 2}, {**PLAIN, "rate": 5})
    _, seen = drive(trial_of(), eyes, 7)
    for k, one in enumerate(seen):
        assert observation_space(eyes).contains(one)
        past = [seen[max(k - back, 0)]["now"] for back in (4, 2, 0)]
        np.testing.assert_array_equal(one["past"], np.stack(past))
        np.testing.assert_array_equal(one["rgb"], seen[k - k % 2]["now"])
    again = Episode(trial_of(), eyes)
    again.reset()
    assert same([again.repeat([(0.05, 0.5, 0.0)] * 7).observation], seen[-1:]), "after a crash, too"


def test_a_jpeg_has_the_same_losses_everywhere() -> None:
    small = rig({**PLAIN, "jpeg": 60, "history": 2})
    _, seen = drive(trial_of(), small)
    _, compressed = drive(trial_of(), small, compressed=True)
    _, raw = drive(trial_of(), Track.CAMERA)
    for lossy, sent, plain in zip(seen, compressed, raw, strict=True):
        np.testing.assert_array_equal(np.stack([picture_of(one) for one in sent["rgb"]]), lossy["rgb"])
        assert all(len(one) < 12_000 for one in sent["rgb"])
        assert 0 < np.abs(lossy["rgb"][-1].astype(int) - plain["rgb"]).mean() < 12
    assert cv2.imdecode(np.frombuffer(sent["rgb"][0], np.uint8), cv2.IMREAD_COLOR).shape == (64, 192, 3)


def test_six_cameras_look_where_they_are_mounted() -> None:
    round_about = rig(*({**PLAIN, "name": f"at{yaw}", "yaw": yaw - 180} for yaw in range(0, 360, 60)))
    _, seen = drive(trial_of(), round_about, 1)
    assert len({one.tobytes() for name, one in seen[0].items() if name.startswith("at")}) == 6
    np.testing.assert_array_equal(seen[0]["at180"], drive(trial_of(), rig(PLAIN), 1)[1][0]["rgb"])


@pytest.mark.parametrize("kind", [one for one in available_faults() if one is not FaultKind.COMMISSION])
def test_all_inputs_follow_the_command_that_is_delivered(kind: FaultKind) -> None:
    approach = next(
        name for name in TOWN.approaches if TOWN.approaches[name].type.missing is not None and name.startswith("J5")
    )
    trial = trial_of(kind, approach)
    state, told = drive(trial, Track.STATE, 60, 0.0), drive(trial, TOLD, 60, 0.0)
    assert same(told[1], state[1]), "the command and the car are those of the track"
    if kind is FaultKind.CONTRADICTION:
        return
    for one in told[1]:
        command, words = Command(int(one["command"][0])), text(one["sentence"]).lower()
        if command is Command.VOID:
            assert words == ""
        elif command in DIRECTIONS:
            assert command.name.lower() in words
            assert one["next_command"] == Command.LANE_FOLLOW
            left = one["target_points"][1, 1] - one["target_points"][0, 1]
            side = {Command.LEFT: 1, Command.RIGHT: -1}.get(command, 0)
            assert np.sign(left) == side or abs(left) < 2.0
        else:
            assert not {"left", "right"} & set(words.replace(",", " ").replace(".", " ").split())


@pytest.mark.parametrize("command", DIRECTIONS)
def test_target_points_do_not_tell_whether_a_road_leads_there(command: Command) -> None:
    found, exists = [], set()
    for approach in ("J3-S", "J1-W", "J2-N"):
        trial = trial_of(approach=approach)
        start = trial.start.model_copy(update={"distance": 7.0, "lateral": 0.0, "yaw": 0.0})
        fork = Fork(decision=0, command=command)
        episode = Episode(trial.model_copy(update={"start": start, "fork": fork}), TOLD)
        found.append(episode.reset()["target_points"])
        exists.add(command in trial.junction_type.exits)
    assert exists == {True, False}
    np.testing.assert_allclose(found, [found[0]] * 3, atol=0.01)


def test_early_late_and_commission_put_the_junction_elsewhere() -> None:
    right = drive(trial_of(), TOLD, 1)[1][0]["distance"][0]
    assert right == pytest.approx(trial_of().start.distance, abs=1.0)
    for kind, moved in ((FaultKind.LATE, 15.0), (FaultKind.EARLY, -20.0), (FaultKind.COMMISSION, -40.0)):
        approach = "J1-W" if kind is FaultKind.COMMISSION else "J3-S"
        trial = trial_of(kind, approach)
        told = drive(trial, TOLD, 1)[1][0]
        assert told["distance"][0] == pytest.approx(trial.start.distance + moved, abs=1.0)
        assert told["next_command"][0] in DIRECTIONS


def test_a_contradiction_is_between_the_inputs() -> None:
    trial = trial_of(FaultKind.CONTRADICTION)
    wrong = trial.junction_type.missing
    words = rig(navigation=["sentence"], sentences=["plain"])
    heard, seen = drive(trial, words, 140, 0.0)[1], drive(trial, TOLD, 140, 0.0)[1]
    plain = [one["command"][0] for one in drive(trial.twin(), Track.STATE, 140, 0.0)[1]]
    within = [k for k, one in enumerate(seen) if one["command"][0] == trial.route]
    assert [one["command"][0] for one in seen] == plain
    assert within
    for k in within:
        assert wrong.name.lower() in text(seen[k]["sentence"]).lower()
        both = text(heard[k]["sentence"]).lower()
        assert -1 < both.find(trial.route.name.lower()) < both.rfind(wrong.name.lower())


def test_a_sentence_is_drawn_once_for_a_trial() -> None:
    kinds = {text(drive(trial_of(seed=seed), Track.WORDS, 1)[1][0]["sentence"]) for seed in range(40)}
    assert len(kinds) > 5
    one = rig(navigation=["sentence"], sentences=["plain"])
    assert len({text(seen["sentence"]) for seen in drive(trial_of(FaultKind.OMISSION), one, 60, 0.0)[1]}) == 1
    assert [field.name for field in fields_of(Track.WORDS)] == ["speed", "steering", "sentence", "rgb"]
