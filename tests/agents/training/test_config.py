import ast
import inspect

import pytest

from wrongturn_agents.training import config as module
from wrongturn_agents.training.config import ALGORITHMS, config_of
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.train import train
from wrongturn_protocol import TRAINING_WEATHERS


def test_every_field_is_documented():
    classes = [node for node in ast.parse(inspect.getsource(module)).body if isinstance(node, ast.ClassDef)]
    fields = 0
    for node in classes:
        for here, following in zip(node.body, [*node.body[1:], None], strict=True):
            if isinstance(here, ast.AnnAssign) and "ClassVar" not in ast.unparse(here.annotation):
                fields += 1
                assert isinstance(following, ast.Expr), f"{node.name}.{ast.unparse(here.target)} has no docstring"
    assert fields > 30


def test_the_papers_training_conditions():
    assert TRAINING_WEATHERS == ("ClearNoon", "WetNoon", "HardRainNoon", "ClearSunset")
    assert [config_of(name).variant for name in ALGORITHMS] == [None] * 4


@pytest.mark.parametrize(
    ("algorithm", "option", "variant"),
    [
        ("ppo-auxiliary", "auxiliary=false", "without-auxiliary-loss"),
        ("ppo-auxiliary", "augment=no", "without-augmentation"),
        ("ppo-image", "augment=0", "without-augmentation"),
        ("ppo-image", "pretrained=False", "without-pretraining"),
        ("ppo-segmentation", "masked_classes=0.3", "masked-classes"),
        ("ppo-segmentation", "n_epochs=2", None),
    ],
)
def test_ablations_name_their_variant(algorithm, option, variant):
    assert config_of(algorithm).with_options([option]).variant == variant


def test_a_stored_run_keeps_what_it_was_trained_with():
    now = config_of("ppo-image")
    assert (now.projection_learning_rate, now.near_junctions, now.near_bends, now.inside_junctions) == (
        *(0.1, 0.3, 0.2, 0.2),
    )
    stored = now.as_dict() | {"near_junctions": 0.4, "near_bends": 0.25}
    youngest = ("traffic", "vehicles", "pedestrians", "hesitant", "leaders", "crossers", "waiters", "collision_penalty")
    for younger in ("inside_junctions", "projection_learning_rate", "window_nearest", "window_farthest", *youngest):
        del stored[younger]
    then = config_of("ppo-image", stored)
    assert (now.traffic, now.crossers, now.waiters, now.collision_penalty) == (0.7, 0.5, 0.3, 2.0)
    assert (then.traffic, then.crossers, then.waiters, then.collision_penalty) == (0.0, 0.0, 0.0, 0.0)
    assert (now.window_nearest, now.window_farthest) == (10.0, 20.0)
    assert (then.window_nearest, then.window_farthest) == (15.0, 15.0)
    assert (then.projection_learning_rate, then.near_junctions, then.near_bends, then.inside_junctions) == (
        *(1.0, 0.4, 0.25, 0.0),
    )


def test_options_are_read_by_their_kind():
    config = config_of("ppo-image").with_options(["steps=1_000", "gamma=0.9", "augment=true"])
    assert (config.steps, config.gamma, config.augment) == (1000, 0.9, True)


@pytest.mark.parametrize("option", ["steps", "colour=3", "steps=many", "bf16=perhaps"])
def test_options_that_cannot_be(option):
    with pytest.raises(TrainingError, match=option.partition("=")[0]):
        config_of("ppo-image").with_options([option])


def test_an_algorithm_that_is_not_there():
    with pytest.raises(TrainingError, match="ppo-auxiliary"):
        config_of("dqn")


@pytest.mark.parametrize("option", ["gamma=nan", "gamma=1.5", "batch_size=0", "n_steps=-1", "time_limit=-5"])
def test_numbers_without_sense_are_named(option):
    with pytest.raises(TrainingError, match=option.partition("=")[0]):
        config_of("ppo-segmentation").with_options([option])


@pytest.mark.parametrize("seed", [-1, 2**32])
def test_seeds_without_sense_are_named(tmp_path, seed):
    with pytest.raises(TrainingError, match="seed"):
        train("ppo-segmentation", directory=tmp_path / "run", seed=seed, steps=16)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "option",
    ["traffic=1.2", "hesitant=-0.1", "leaders=2", "crossers=nan", "waiters=1.01", "vehicles=201", "pedestrians=-1"],
)
def test_traffic_that_cannot_be_is_refused(option):
    with pytest.raises(TrainingError, match=f"option {option.partition('=')[0]}: is"):
        config_of("ppo-segmentation").with_options([option])


def test_a_drive_may_have_cars_or_pedestrians_alone():
    config = config_of("ppo-segmentation").with_options(["vehicles=0", "pedestrians=20"])
    assert (config.vehicles, config.pedestrians) == (0, 20)
