"""Each disturbance changes what it says, by its dose and seed, and nothing else."""

import math
from dataclasses import replace

import numpy as np
import pytest

from wrongturn_networks import draw_trial, faults, load_town
from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_protocol import Fault, FaultKind, SegmentationClass, Track, Trial
from wrongturn_sim import Episode, WrongturnVectorEnv
from wrongturn_sim.camera import Camera
from wrongturn_sim.errors import TrialNotAloneError

KINDS = [one for one in faults.available_faults() if issubclass(faults.fault_class(one), Disturbance)]
STEERS = [0.0, 0.3, -0.2, 0.9, -0.7, 0.1, 0.0, 0.25]


def trial_of(kind: FaultKind, dose: float, seed: int) -> Trial:
    return draw_trial(load_town("Town01"), "J3-S", Fault(kind=kind, dose=dose), seed)


def drive(trial: Trial, track: Track = Track.SEGMENTATION, camera: Camera | None = None, gain: float = 1.0):
    episode = Episode(trial, track, camera=camera)
    seen = [episode.reset()]
    seen += [episode.step(min(max(gain * steer, -1.0), 1.0), 0.5, 0.0).observation for steer in STEERS]
    return episode, seen


def same(one, other) -> bool:
    return all(np.array_equal(a[key], b[key]) for a, b in zip(one, other, strict=True) for key in a)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", [4, 5])
def test_a_dose_of_0_changes_nothing_and_any_other_comes_back(kind: FaultKind, seed: int) -> None:
    plain = drive(trial_of(FaultKind.NONE, 0, seed).model_copy(update={"fault": Fault(kind=FaultKind.NONE)}))[1]
    assert same(drive(trial_of(kind, 0.0, seed))[1], plain)
    trial = trial_of(kind, faults.fault_class(kind).dose.usual, seed)
    seen = drive(trial)[1]
    assert same(drive(trial)[1], seen)
    assert not same(seen, plain)
    again = Episode(trial, Track.SEGMENTATION)
    again.reset()
    assert same([again.repeat([(steer, 0.5, 0.0) for steer in STEERS]).observation], seen[-1:])
    assert [one["command"] for one in seen] == [one["command"] for one in plain]


@pytest.mark.parametrize("seed", [4, 5])
def test_the_camera_is_mounted_otherwise(seed: int) -> None:
    sign, usual = 1.0 - 2.0 * (seed % 2), Camera()
    for kind, dose, camera in (
        (FaultKind.PITCH, 3.0, replace(usual, pitch=-sign * math.radians(3.0))),
        (FaultKind.HEIGHT, 0.5, replace(usual, up=usual.up + sign * 0.5)),
        (FaultKind.FOCAL_LENGTH, 20.0, replace(usual, focal=usual.focal * (1.0 + sign * 0.2))),
    ):
        twin = trial_of(kind, dose, seed).twin()
        assert same(drive(trial_of(kind, dose, seed))[1], drive(twin, camera=camera)[1])


def test_noise_is_of_its_deviation_and_new_at_each_decision() -> None:
    trial = trial_of(FaultKind.NOISE, 10.0, 4)
    noisy, plain = (drive(one, Track.CAMERA)[1] for one in (trial, trial.twin()))
    added = [a["rgb"].astype(int) - b["rgb"] for a, b in zip(noisy, plain, strict=True)]
    middling = [one[(b["rgb"] > 60) & (b["rgb"] < 195)] for one, b in zip(added, plain, strict=True)]
    assert all(9.5 < one.std() < 10.5 and abs(one.mean()) < 0.5 for one in middling)
    assert not np.array_equal(added[0], added[1])


@pytest.mark.parametrize("track", [Track.CAMERA, Track.PRIVILEGED])
def test_a_delay_shows_what_was_and_the_command_that_is(track: Track) -> None:
    trial = trial_of(FaultKind.DELAY, 0.3, 4)
    late, plain = (drive(one, track)[1] for one in (trial, trial.twin()))
    for decision, seen in enumerate(late):
        before = plain[max(decision - 3, 0)] | {"command": plain[decision]["command"]}
        assert same([seen], [before])


@pytest.mark.parametrize("seed", [4, 5])
def test_the_wheels_turn_by_the_gain(seed: int) -> None:
    trial = trial_of(FaultKind.STEERING_GAIN, 40.0, seed)
    strong, _ = drive(trial, Track.STATE)
    plain, _ = drive(trial.twin(), Track.STATE, gain=0.6 if seed % 2 else 1.4)
    states = [np.array([row[1:6] for row in one.trajectory.rows]) for one in (strong, plain)]
    assert np.allclose(*states, rtol=0.0, atol=1e-6)  # the plain car's steering is rounded to float32 once more
    assert strong.trajectory.rows[-1].steer == pytest.approx(STEERS[-1])


def test_masked_classes_are_void_and_the_road_is_never() -> None:
    trial = trial_of(FaultKind.MASKED_CLASSES, 9.0, 4)
    masked, plain = (drive(one)[1] for one in (trial, trial.twin()))
    for a, b in zip(masked, plain, strict=True):
        road = b["segmentation"] == SegmentationClass.ROAD
        assert np.array_equal(a["segmentation"], np.where(road, SegmentationClass.ROAD, SegmentationClass.VOID))
    hidden = []
    for seed in range(8):
        trial = trial_of(FaultKind.MASKED_CLASSES, 1.0, seed)
        one, seen = (drive(each)[1][0]["segmentation"] for each in (trial, trial.twin()))
        hidden.append({int(value) for value in seen[one != seen]})
    # One class each, another by another seed; nothing changes where the class is not in the picture.
    assert max(map(len, hidden)) == 1
    assert len(set().union(*hidden)) > 1


@pytest.mark.parametrize("kind", KINDS)
def test_cars_of_one_batch_are_alike(kind: FaultKind) -> None:
    with pytest.raises(TrialNotAloneError, match=f"{kind} changes the town, or one car"):
        WrongturnVectorEnv(2, trial=trial_of(kind, 1.0, 4)).reset()
