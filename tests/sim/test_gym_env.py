import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils.env_checker import check_env

from wrongturn_networks import UnknownTrialError, load_suite, load_town
from wrongturn_protocol import Action, Command
from wrongturn_sim import EpisodeNotStartedError, InvalidActionError, WrongturnSimEnv
from wrongturn_sim.errors import DependencyMissingError
from wrongturn_sim.faults import FaultNotApplicableError
from wrongturn_sim.view.colours import CAR

ID = "wrongturn_sim:WrongturnSim-v0"
COAST = np.array([0.0, 0.2, 0.0], np.float32)


@pytest.mark.parametrize("track", ["state", "privileged"])
def test_gymnasiums_checker(track):
    env = gymnasium.make(ID, town="junctions", track=track)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*infinity.*")  # the town's frame has no end
        check_env(env.unwrapped, skip_render_check=True)
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("track", ["state", "privileged"])
def test_stable_baselines_checker_and_a_hundred_steps_of_ppo(track):
    sb3 = pytest.importorskip("stable_baselines3")
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # advice on normalised actions and on images
        env = gymnasium.make(ID, town="junctions", track=track, fault="infeasible")
        checker.check_env(env.unwrapped)
        model = sb3.PPO("MultiInputPolicy", env, n_steps=50, batch_size=25, n_epochs=1, device="cpu", seed=1)
        model.learn(100)
    assert model.num_timesteps == 100


def test_a_reset_with_a_seed_draws_the_same_trials_and_each_another():
    env = gymnasium.make(ID, town="Town01", track="state", fault="omission")
    one = [env.reset(seed=5 if k == 0 else None)[1]["trial"] for k in range(4)]
    other = [env.reset(seed=5 if k == 0 else None)[1]["trial"] for k in range(4)]
    assert one == other
    assert len(set(one)) == 4
    assert all(".omission." in name for name in one)


def test_trials_are_drawn_in_town01_by_default():
    assert gymnasium.make(ID).reset(seed=1)[1]["town"] == "Town01"
    assert gymnasium.make(ID, task="cruise").reset(seed=1)[1]["town"] == "Town01"


def test_an_approach_a_trial_and_a_suite():
    approach = min(load_town("Town01").approaches)
    env = gymnasium.make(ID, town="Town01", approach=approach)
    assert all(f"Town01.{approach}." in env.reset(seed=k)[1]["trial"] for k in range(3))
    suite = load_suite("smoke@2")
    trial, twin = suite.trials[0], suite.open_draw.twins[0]
    env = gymnasium.make(ID, suite=suite.id, track="privileged")
    assert env.reset(seed=1)[1]["trial"] in {episode.id for episode in suite.episodes}
    assert env.reset(options={"trial": trial.id})[1]["trial"] == trial.id
    assert env.reset(options={"trial": twin.id})[1]["trial"] == twin.id
    # Trials of another draw are handed in whole.
    other = suite.draw("a secret").trials[0]
    assert env.reset(options={"trial": other})[1]["trial"] == other.id
    with pytest.raises(UnknownTrialError):
        env.reset(options={"trial": other.id})
    env = gymnasium.make(ID, suite=suite.id, trial=trial.id)
    assert {env.reset()[1]["trial"] for _ in range(3)} == {trial.id}


def test_the_end_tells_the_verdict():
    env = gymnasium.make(ID, town="junctions", track="state")
    env.reset(seed=1)
    ended = False
    while not ended:
        _, reward, terminated, truncated, info = env.step(np.array([0.0, 0.0, 1.0], np.float32))
        ended = terminated or truncated
        assert ("verdict" in info) is ended
    assert info["verdict"] == info["outcome"]["verdict"] == "not_engaged"
    assert isinstance(reward, float)


def test_bad_actions_and_steps_out_of_turn():
    env = gymnasium.make(ID, town="junctions").unwrapped
    with pytest.raises(EpisodeNotStartedError):
        env.step(COAST)
    env.reset(seed=0)
    for action in ([0.0, 0.0], "left", None, np.zeros((3, 2))):
        with pytest.raises(InvalidActionError, match="action"):
            env.step(action)
    with pytest.raises(InvalidActionError, match=r"action\.brake"):
        env.step(np.array([0.0, 0.0, np.nan], np.float32))
    assert env.episode.steps == 0


def test_an_action_may_be_an_action_an_array_a_tuple_or_a_list():
    env = WrongturnSimEnv("junctions")
    driven = set()
    for action in (Action(0.1, 0.4, 0.0), np.float32([0.1, 0.4, 0.0]), (0.1, 0.4, 0), [0.1, 0.4, 0]):
        env.reset(seed=0)
        env.step(action)
        driven.add(env.episode.actions_sha256)
    assert len(driven) == 1


@pytest.mark.parametrize(
    ("arguments", "error", "named"),
    [
        ({"town": "Nowhere"}, Exception, "Town01"),
        ({"town": "Town01", "approach": "J99-S"}, Exception, "J99-S"),
        ({"town": "Town01", "suite": "smoke@2"}, ValueError, "suite"),
        ({"town": "Town01", "trial": "Town01.J1-S.none.s1"}, ValueError, "suite"),
        ({"town": "Town01", "fault": "gremlins"}, ValueError, "gremlins"),
        ({"town": "Town01", "track": "radar"}, ValueError, "radar"),
        ({"town": "Town01", "render_mode": "ansi"}, ValueError, "render_mode"),
    ],
)
def test_what_cannot_be_made_says_why(arguments, error, named):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(error, match=named):
            gymnasium.make(ID, **arguments)


def test_a_route_is_that_of_each_drawn_trial():
    env = gymnasium.make(ID, town="junctions", route=1)
    for seed in range(5):
        env.reset(seed=seed)
        assert env.unwrapped.episode.trial.route is Command.LEFT


def test_infeasible_at_a_crossing_is_refused():
    town = load_town("junctions")
    crossing = next(name for name, arm in town.approaches.items() if arm.type.missing is None)
    with pytest.raises(FaultNotApplicableError, match="infeasible"):
        gymnasium.make(ID, town="junctions", approach=crossing, fault="infeasible")


def test_trials_are_drawn_at_approaches_that_are_long_enough():
    env = gymnasium.make(ID, town="Town02", fault="infeasible")
    assert len({env.reset(seed=k)[1]["trial"].split(".")[1] for k in range(60)}) > 12


def test_a_rendered_picture_shows_the_view_from_above_beside_the_cameras():
    env = gymnasium.make(ID, town="junctions", track="camera", render_mode="rgb_array")
    assert env.metadata["render_fps"] == 10
    seen, _ = env.reset(seed=1)
    for _ in range(3):
        seen, *_ = env.step(COAST)
    image = env.render()
    assert (image.dtype, image.shape) == (np.uint8, (480, 864, 3))
    assert np.array_equal(image[:128:2, 480::2], seen["rgb"])
    assert (image[230:250, 230:250] == CAR).all(-1).any(), "the view from above follows the car"
    env.close()
    assert gymnasium.make(ID, town="junctions").unwrapped.render_mode is None


def test_human_mode_shows_each_picture_in_a_window(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pygame = pytest.importorskip("pygame")
    env = gymnasium.make(ID, town="junctions", render_mode="human")
    env.reset(seed=1)
    shown = [pygame.surfarray.array3d(pygame.display.get_surface())]
    env.step(np.float32([0.0, 1.0, 0.0]))
    env.step(np.float32([0.0, 1.0, 0.0]))
    assert not pygame.mixer.get_init(), "it starts no sound"
    shown.append(pygame.surfarray.array3d(pygame.display.get_surface()))
    assert shown[0].shape == (864, 480, 3)
    assert not np.array_equal(*shown)
    assert np.array_equal(shown[1].swapaxes(0, 1), env.unwrapped.episode.view())
    assert env.render() is None
    env.close()
    env.close()
    assert pygame.display.get_surface() is None


def test_without_pygame_human_mode_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(DependencyNotInstalled, match=r"pip install 'wrongturn-client\[human\]'"):
        WrongturnSimEnv("junctions", render_mode="human")


def test_an_episode_is_plotted_in_a_notebook(monkeypatch):
    env = WrongturnSimEnv("junctions")
    env.reset(seed=1)
    for _ in range(5):
        env.step(COAST)
    figure = env.episode.plot()
    above, beside = figure.axes[:2]
    assert above.get_title() == env.episode.trial.id
    (way,) = above.collections
    rows = env.episode.trajectory.rows
    assert len(way.get_segments()) == len(rows) - 1
    assert tuple(way.get_segments()[-1][-1]) == (rows[-1].x, rows[-1].y)
    assert beside.lines[0].get_ydata().tolist() == [row.v for row in rows]
    monkeypatch.setitem(sys.modules, "matplotlib.colors", None)
    with pytest.raises(DependencyMissingError, match=r"pip install 'wrongturn-service\[plot\]'"):
        env.episode.plot()
