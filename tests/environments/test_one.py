"""What every environment promises that drives one trial at a time, in process and over the wire."""

import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from kinds import BRAKE, GAS, Environments

from wrongturn_networks import draw_trial, load_suite, load_town
from wrongturn_networks.disturbances.disturbance import Disturbance
from wrongturn_networks.faults import available_faults, fault_class
from wrongturn_protocol import Action, Command, Fault, FaultKind, OptionError, Track
from wrongturn_protocol.observations import action_space, observation_space
from wrongturn_sim import Episode


@pytest.mark.parametrize("track", list(Track))
def test_spaces_are_the_tracks(kind: Environments, track: Track) -> None:
    env = kind.one(track=track)
    assert env.observation_space == observation_space(track)
    assert env.action_space == action_space()
    observation, info = env.reset(seed=1)
    assert env.observation_space.contains(observation)
    assert info.keys() == {"trial", "town"}
    observation, reward, terminated, truncated, info = env.step(GAS)
    assert env.observation_space.contains(observation)
    assert isinstance(reward, float)
    assert (terminated, truncated, info) == (False, False, {})


@pytest.mark.parametrize("track", ["state", "privileged"])
def test_gymnasiums_checker(kind: Environments, track: str) -> None:
    env = kind.one(track=track, render_mode="rgb_array")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*infinity.*")  # the town's frame has no end
        check_env(env, skip_render_check=True)


def test_a_seed_draws_the_same_trials_and_each_another(kind: Environments) -> None:
    env = kind.one(town="Town01", fault="omission")
    one = [env.reset(seed=5 if k == 0 else None)[1]["trial"] for k in range(4)]
    other = [env.reset(seed=5 if k == 0 else None)[1]["trial"] for k in range(4)]
    assert one == other
    assert len(set(one)) == 4
    assert all(".omission." in name for name in one)


@pytest.mark.parametrize("fault", available_faults())
def test_each_fault_is_delivered(kind: Environments, fault: FaultKind) -> None:
    given = Fault(kind=fault, dose=0.75, period=0.8) if fault is FaultKind.FLICKER else fault
    track = Track.SEGMENTATION if issubclass(fault_class(fault), Disturbance) else Track.STATE
    env = kind.one(town="Town01", fault=given, route=Command.RIGHT, track=track)
    observation, info = env.reset(seed=4)
    _, approach, label, seed = info["trial"].split(".")
    assert label == ("flicker-0p75-0p8" if fault is FaultKind.FLICKER else fault)
    trial = draw_trial(load_town("Town01"), approach, given, int(seed.removeprefix("s")), route=Command.RIGHT)
    episode = Episode(trial, track)
    expected, over = episode.reset(), False
    while not over:
        assert observation.keys() == expected.keys()
        assert all(np.array_equal(observation[name], value) for name, value in expected.items())
        action = (0.0, 0.4 if float(observation["speed"][0]) < 6.0 else 0.0, 0.0)
        observation, _, terminated, truncated, info = env.step(np.array(action, np.float32))
        expected, over = episode.step(*action).observation, terminated or truncated
    assert info["verdict"] == episode.outcome.verdict


def test_town_and_approach(kind: Environments) -> None:
    approach = min(load_town("Town01").approaches)
    env = kind.one(town=None, approach=approach)
    for seed in range(3):
        info = env.reset(seed=seed)[1]
        assert info["town"] == "Town01"
        assert f"Town01.{approach}." in info["trial"]
    env = kind.one(town=None, task="cruise")
    assert env.reset(seed=1)[1]["town"] == "Town01"


def test_a_suites_trials(kind: Environments) -> None:
    suite = load_suite("smoke@3")
    trial, twin = suite.trials[0], suite.open_draw.twins[0]
    env = kind.one(suite=suite.id, track="privileged")
    assert env.reset(seed=1)[1]["trial"] in {episode.id for episode in suite.episodes}
    for one in (trial, twin):
        assert env.reset(options={"trial": one.id})[1]["trial"] == one.id
    with pytest.raises(Exception, match=suite.draw("a secret").trials[0].id):
        env.reset(options={"trial": suite.draw("a secret").trials[0].id})
    env = kind.one(suite=suite.id, trial=trial.id)
    assert {env.reset()[1]["trial"] for _ in range(3)} == {trial.id}


def test_the_end_tells_the_verdict_and_then_it_is_reset(kind: Environments) -> None:
    env = kind.one()
    env.reset(seed=1)
    ended = False
    while not ended:
        _, _, terminated, truncated, info = env.step(BRAKE)
        ended = terminated or truncated
        assert ("verdict" in info) is ended
    assert info["verdict"] == "not_engaged"
    with pytest.raises(Exception, match="reset"):
        env.step(BRAKE)
    env.reset()
    env.step(GAS)
    env.close()
    env.reset()
    env.step(GAS)


@pytest.mark.parametrize(
    ("action", "named"),
    [
        ([np.nan, 0, 0], r"action\.steer"),
        ([0, 2, 0], r"action\.throttle"),
        ([0, 0, np.nan], r"action\.brake"),
        ([0, 0], "action.*three numbers"),
        (np.zeros((3, 2)), "action.*three numbers"),
        ("left", "action.*three numbers"),
        (None, "action.*three numbers"),
    ],
)
def test_an_action_that_is_none_is_named_and_not_driven(kind: Environments, action: Any, named: str) -> None:
    env, other = kind.one(), kind.one()
    with pytest.raises(Exception, match="reset"):
        env.step(GAS)
    env.reset(seed=0)
    other.reset(seed=0)
    with pytest.raises(ValueError, match=named):
        env.step(action)
    assert env.step(GAS)[0] == other.step(GAS)[0]


def test_an_action_may_be_an_action_an_array_a_tuple_or_a_list(kind: Environments) -> None:
    env = kind.one()
    seen = set()
    for action in (Action(0.1, 0.4, 0.0), np.float32([0.1, 0.4, 0.0]), (0.1, 0.4, 0), [0.1, 0.4, 0]):
        env.reset(seed=0)
        seen.add(tuple(array.tobytes() for array in env.step(action)[0].values()))
    assert len(seen) == 1


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"suite": "smoke@3", "town": "Town01"}, "suite"),
        ({"track": "cam"}, r"^track: 'cam' is unknown; .*\. Did you mean camera\?$"),
        ({"fault": "infeasable"}, r"^fault: 'infeasable' is unknown; .*\. Did you mean infeasible\?$"),
        ({"traffic": {"vehicle": 2}}, r"^traffic\.vehicle: .*\. Did you mean vehicles\?$"),
        ({"render_mode": "ansi"}, "render_mode"),
    ],
)
def test_what_cannot_be_made_says_why(kind: Environments, options: dict[str, Any], named: str) -> None:
    """Some of the options that ``tests/protocol/test_trial_options.py`` has all of."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for make in (kind.one, kind.many):
            with pytest.raises(ValueError, match=named):
                make(**options)


def test_an_option_that_does_not_exist_is_told_with_all_that_do(kind: Environments) -> None:
    own = ("url", "token", "patience") if kind.is_remote else ("strict", "camera")
    for make in (kind.one, kind.many):
        with pytest.raises(
            TypeError, match=r"^rendr_mode: there is no such option; .*\. Did you mean render_mode\?"
        ) as told:
            make(rendr_mode="human")
        for name in (*own, "render_mode", "town", "track", "traffic"):
            assert f" {name}" in str(told.value)


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"trail": "x"}, r"^options\.trail: there is no such option; give trial.*\. Did you mean trial\?$"),
        ({"seed": 3}, r"^options\.seed: there is no such option; give trial[^.]*$"),
        (["trial"], r"^options: is \['trial'\]; give a dict with trial"),
    ],
)
def test_an_unknown_option_of_reset_is_named(kind: Environments, options: Any, named: str) -> None:
    for env in (kind.one(), kind.many()):
        with pytest.raises(OptionError, match=named):
            env.reset(options=options)


@pytest.mark.parametrize(
    ("options", "named"), [({"town": "Nowhere"}, "Town01"), ({"town": "Town01", "approach": "J99-S"}, "J99-S")]
)
def test_a_place_that_is_not_there_says_which_there_are(
    kind: Environments, options: dict[str, Any], named: str
) -> None:
    with pytest.raises(Exception, match=named):
        kind.one(**options).reset()


def test_pictures_show_the_view_from_above_beside_the_cameras(kind: Environments) -> None:
    env = kind.one(track="camera", render_mode="rgb_array")
    assert env.metadata["render_fps"] == 10
    with pytest.raises(Exception, match="reset"):
        env.render()
    env.reset(seed=1)
    seen, *_ = env.step(GAS)
    image: Any = env.render()
    assert (image.dtype, image.shape) == (np.uint8, (480, 864, 3))
    assert np.array_equal(image[:128:2, 480::2], seen["rgb"])
    env = kind.one()
    env.reset()
    assert (env.render_mode, env.render()) == (None, None)


def test_a_trial_looks_the_same_in_process_and_over_the_wire(
    in_process: Environments, over_the_wire: Environments
) -> None:
    trial = load_suite("smoke@3").trials[0].id
    envs = [kind.one(suite="smoke@3", trial=trial, track="privileged") for kind in (in_process, over_the_wire)]
    shown = [[env.reset()[0]] for env in envs]
    told = [{}, {}]
    for i, env in enumerate(envs):
        while not told[i]:
            seen, _, _, _, told[i] = env.step(GAS)
            shown[i].append(seen)
    assert told[0]["verdict"] == told[1]["verdict"]
    for one, other in zip(*shown, strict=True):
        assert {name: array.tobytes() for name, array in one.items()} == {
            name: array.tobytes() for name, array in other.items()
        }
