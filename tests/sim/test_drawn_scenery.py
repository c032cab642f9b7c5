"""A trial names its town's scenery: camera, judge, fleet and replay have the same, and share the net's part."""

import numpy as np
import pytest

from wrongturn_judge import JourneyGeometry, JudgeGeometry
from wrongturn_networks import load_town, read_town, town_of
from wrongturn_networks.loading import write_town
from wrongturn_protocol import Track, Trial
from wrongturn_sim import Episode, WrongturnVectorEnv
from wrongturn_sim.camera import World
from wrongturn_sim.errors import TrialNotAloneError
from wrongturn_sim.replay import Replay


@pytest.fixture(scope="module")
def trial(make_trial) -> Trial:
    return make_trial(seed=3).model_copy(update={"scenery": 2**53 - 1})


@pytest.fixture(scope="module")
def written(trial, tmp_path_factory):
    """The trial's town as a folder of its own would have it."""
    folder = tmp_path_factory.mktemp("towns") / trial.town
    write_town(town_of(trial), folder)
    return read_town(folder)


def test_what_is_shared_equals_what_is_made_anew(trial, written):
    drawn, shipped = town_of(trial), load_town(trial.town)
    assert town_of(trial) is drawn
    assert drawn.road is shipped.road
    assert (drawn.sha256, drawn.scenery) == (written.sha256, written.scenery)
    assert drawn.sha256 != shipped.sha256
    for made, wanted in (
        (JudgeGeometry.of(drawn, trial), JudgeGeometry.of(written, trial)),
        (JourneyGeometry.of(drawn), JourneyGeometry.of(written)),
    ):
        assert made.town_sha256 == wanted.town_sha256 == drawn.sha256
        for name in ("head", "floats", "ints", "cells"):
            assert np.array_equal(getattr(made.packed, name), getattr(wanted.packed, name), equal_nan=True)
    assert np.array_equal(World.of(drawn).scenery, World.of(written).scenery)
    # The shades of the asphalt are those of the shipped town; kinds of ground and shadows are its own.
    assert np.array_equal(World.of(drawn).ground & 0xF0, World.of(written).ground & 0xF0)
    assert not np.array_equal(World.of(drawn).ground, World.of(shipped).ground)


def test_episode_fleet_and_replay_see_the_same(trial):
    episode = Episode(trial, Track.SEGMENTATION)
    envs = WrongturnVectorEnv(1, trial=trial, track=Track.SEGMENTATION)
    seen, (observation, _) = [episode.reset()], envs.reset(seed=1)
    for name in seen[0]:
        assert np.array_equal(observation[name][0], seen[0][name])
    for _ in range(15):
        seen.append(episode.step(0.0, 0.4, 0.0).observation)
        observation = envs.step(np.array([[0.0, 0.4, 0.0]], np.float32))[0]
    assert envs.episode(0).trajectory.to_json() == episode.trajectory.to_json()
    assert episode.trajectory.town_sha256 == town_of(trial).sha256
    replay = Replay.from_json(episode.trajectory.to_json())
    assert replay.notes == ()
    for decision in (0, 15):
        assert np.array_equal(replay.camera(decision)[0], seen[decision]["rgb"])
    assert np.array_equal(observation["rgb"][0], seen[-1]["rgb"])
    shipped = trial.model_copy(update={"scenery": None})
    assert not np.array_equal(Episode(shipped, Track.CAMERA).reset()["rgb"], seen[0]["rgb"])
    with pytest.raises(TrialNotAloneError, match=r"trial\.scenery"):
        envs.reset(options={"trial": shipped})
