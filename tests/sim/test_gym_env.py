import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from wrongturn_networks import UnknownTrialError, load_suite
from wrongturn_protocol import Command
from wrongturn_sim import WrongturnSimEnv
from wrongturn_sim.errors import DependencyMissingError
from wrongturn_sim.view.colours import CAR

ID = "wrongturn_sim:WrongturnSim-v0"
COAST = np.array([0.0, 0.2, 0.0], np.float32)


def test_a_route_is_that_of_each_drawn_trial():
    env = gymnasium.make(ID, town="junctions", route=1)
    for seed in range(5):
        env.reset(seed=seed)
        assert env.unwrapped.episode.trial.route is Command.LEFT


def test_a_trial_of_another_draw_is_handed_in_whole():
    suite = load_suite("smoke@3")
    env = gymnasium.make(ID, suite=suite.id, track="privileged")
    other = suite.draw("a secret").trials[0]
    assert env.reset(options={"trial": other})[1]["trial"] == other.id
    with pytest.raises(UnknownTrialError):
        env.reset(options={"trial": other.id})


def test_trials_are_drawn_at_approaches_that_are_long_enough():
    env = gymnasium.make(ID, town="Town02", fault="infeasible")
    assert len({env.reset(seed=k)[1]["trial"].split(".")[1] for k in range(60)}) > 12


def test_the_view_from_above_follows_the_car():
    env = gymnasium.make(ID, town="junctions", render_mode="rgb_array")
    env.reset(seed=1)
    env.step(COAST)
    assert (env.render()[230:250, 230:250] == CAR).all(-1).any()


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
    with pytest.raises(DependencyNotInstalled, match="pip install pygame"):
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
    with pytest.raises(DependencyMissingError, match="pip install matplotlib"):
        env.episode.plot()
