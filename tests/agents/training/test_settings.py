import ast
import inspect

import pytest
import torch
from small_run import settings_of

from wrongturn_agents.training.devices import memory_named
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.method import find_method, method_names
from wrongturn_agents.training.run import train


@pytest.mark.parametrize("name", method_names())
def test_every_field_is_documented(name):
    fields = 0
    for kind in find_method(name).settings.__mro__[:-1]:
        for node in ast.parse(inspect.getsource(kind)).body:
            assert isinstance(node, ast.ClassDef)
            for here, following in zip(node.body, [*node.body[1:], None], strict=True):
                if isinstance(here, ast.AnnAssign) and "ClassVar" not in ast.unparse(here.annotation):
                    fields += 1
                    assert isinstance(following, ast.Expr), f"{node.name}.{ast.unparse(here.target)} has no docstring"
    assert fields > 10


@pytest.mark.parametrize(
    ("algorithm", "options", "variant"),
    [
        ("ppo-auxiliary", ["auxiliary=false"], "without-auxiliary-loss"),
        ("ppo-auxiliary", ["augment=no"], "without-augmentation"),
        ("ppo-image", ["pretrained=False", "augment=0"], "without-pretraining-and-augmentation"),
        ("ppo-segmentation", ["masked_classes=0.3"], "masked-classes"),
        ("ppo-segmentation", ["n_epochs=2"], None),
        ("marln", ["pretrained=false"], "without-pretraining"),
        ("marln", ["augment=false"], "without-augmentation"),
        ("lbc", ["rounds=0"], "without-dagger"),
        ("lbc", ["rounds=0", "white_box=false"], "without-white-box-and-dagger"),
        ("doubting", ["generated=0"], "without-generated-towns"),
    ],
)
def test_ablations_name_their_variant(algorithm, options, variant):
    assert settings_of(algorithm, *options).variant == variant


def test_options_are_read_by_their_kind():
    config = settings_of("ppo-image", "steps=1_000", "gamma=0.9", "augment=true", "vehicles=0")
    assert (config.steps, config.gamma, config.augment, config.vehicles) == (1000, 0.9, True, 0)


@pytest.mark.parametrize(
    ("algorithm", "option", "said"),
    [
        ("ppo-image", "colour=3", "give name=value with one of"),
        ("ppo-image", "steps=many", "option steps: is 'many'; give a whole number"),
        ("ppo-image", "pretraining_minutes=0", "option pretraining_minutes: is 0; give a number above 0"),
        ("ppo-image", "bf16=perhaps", "option bf16: is 'perhaps'; give true or false"),
        ("ppo-segmentation", "gamma=nan", "option gamma: is nan"),
        ("ppo-segmentation", "gamma=1.5", "give a number from 0 to 1"),
        ("ppo-segmentation", "batch_size=0", "option batch_size: is 0"),
        ("ppo-segmentation", "batch_size=16383", "one alone, without a deviation; give another"),
        ("ppo-segmentation", "activation=sinus", "option activation: is 'sinus'; give one of tanh"),
        ("ppo-segmentation", "window_nearest=0", "option window_nearest: is 0; give a number above 0"),
        ("ppo-segmentation", "time_limit=-5", "option time_limit: is -5"),
        ("ppo-segmentation", "vehicles=201", "option vehicles: is 201; give a number from 0 to 200"),
        ("marln", "replay_size=100", "option replay_size: is 100"),
        ("marln", "learn_after=1", "option learn_after: is 1"),
        ("marln", "replay_ratio=0", "option replay_ratio: is 0"),
        ("marln", "replay_size=1000000000", "option replay_size: 1000000000 decisions need"),
        ("lbc", "width=0", "option width: is 0"),
        ("lbc", "width=4", "option width: is 4; give 8 or more: torch's convolutions crash"),
        ("lbc", "near_junctions=0.9", "more than all drives"),
        ("lbc", "window_nearest=30", "the least and the greatest distance"),
        ("lbc", "begin=1000000", "more than the buffer"),
        ("lbc", "privileged_share=1", "between 0 and 1"),
        ("lbc", "batch_size=1", "2 or more"),
        ("lbc", "buffer=1000000000", "1000000000 samples need"),
        ("doubting", "towns=3", "give name=value with one of"),
        ("doubting", "first_share=2", "give a number from 0 to 1"),
    ],
)
def test_wrong_options_are_named_and_make_no_directory(tmp_path, algorithm, option, said):
    with pytest.raises(TrainingError, match=said):
        train(algorithm, directory=tmp_path / "run", steps=8, device="cpu", options=[option])
    assert not (tmp_path / "run").exists()


def test_a_method_that_is_not_there():
    with pytest.raises(TrainingError, match=r"there is no .dqn.; choose one of .*ppo-auxiliary"):
        find_method("dqn")


def test_on_a_gpu_its_own_free_memory_decides(monkeypatch):
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda _: (2**30, 2**40))
    config = settings_of("marln", "replay_size=400000", "num_envs=4")
    with pytest.raises(TrainingError, match="400000 decisions need 5 GiB, and there are 1"):
        memory_named(config, torch.device("cuda")).__enter__()
