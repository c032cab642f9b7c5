"""A policy of Stable-Baselines3 and its ONNX file drive alike, or the export says why it cannot be."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from wrongturn_protocol.installing import install

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

from gymnasium import spaces  # noqa: E402
from sb3_policies import Branches, Draws, Extractor, RandomTown, made, ppo, saved  # noqa: E402
from stable_baselines3 import A2C, DDPG, DQN, PPO, SAC, TD3  # noqa: E402
from stable_baselines3.common.policies import BasePolicy  # noqa: E402
from stable_baselines3.common.save_util import save_to_zip_file  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize, VecTransposeImage  # noqa: E402
from typer.testing import CliRunner  # noqa: E402

from wrongturn_agents import resolve  # noqa: E402
from wrongturn_agents.training.action import ACTION_SPACE, controls  # noqa: E402
from wrongturn_agents.training.errors import TrainingError  # noqa: E402
from wrongturn_client.cli import app  # noqa: E402
from wrongturn_protocol import Track  # noqa: E402
from wrongturn_protocol.observations import action_space, observation_space  # noqa: E402
from wrongturn_sandbox.checking import check  # noqa: E402
from wrongturn_sb3.export import export_sb3  # noqa: E402

CONTROLS, ACCELERATE = action_space(), ACTION_SPACE
OFF_POLICY = {"buffer_size": 50, "device": "cpu", "seed": 1}


def driven(file: Path, track: Track, number: int = 20) -> list[tuple[dict[str, np.ndarray], np.ndarray]]:
    """Return observations and a file's controls for each, (3,), after what a service checks before it loads a file."""
    check(file.read_bytes())
    agent = resolve(str(file)).make()
    assert agent.track == track
    space = observation_space(track)
    space.seed(5)
    observations = [space.sample() for _ in range(number)]
    actions = [agent.act(observation) for observation in observations]
    return [
        (observation, np.array([action.steer, action.throttle, action.brake]))
        for observation, action in zip(observations, actions, strict=True)
    ]


def assert_alike(model, file: Path, track: Track) -> None:
    """Assert that a file drives as a model predicts, and not always the same."""
    found = driven(file, track)
    for observation, made_controls in found:
        action, _ = model.predict({name: observation[name] for name in model.observation_space}, deterministic=True)
        wanted = controls(action) if model.action_space == ACTION_SPACE else action
        np.testing.assert_allclose(made_controls, wanted, atol=1e-5)
    assert np.ptp([made_controls for _, made_controls in found], axis=0).max() > 0.01


# The tests below export PPO with either kind of actions.
SHORTER = [(SAC, CONTROLS), (TD3, ACCELERATE)]
EACH = [(algorithm, actions) for algorithm in (PPO, A2C, SAC, TD3, DDPG) for actions in (CONTROLS, ACCELERATE)]


@pytest.mark.parametrize(
    ("algorithm", "actions"), [pytest.param(*one, marks=() if one in SHORTER else pytest.mark.soak) for one in EACH]
)
def test_each_algorithm_drives_as_its_policy(tmp_path, algorithm, actions):
    options = {"device": "cpu", "seed": 1} if algorithm in {PPO, A2C} else OFF_POLICY
    model = made(algorithm("MultiInputPolicy", RandomTown(actions=actions), **options))
    exported = export_sb3(saved(model, tmp_path / "agent.zip"), tmp_path / "agent.onnx")
    assert exported.algorithm == algorithm.__name__
    assert exported.outputs == (("steer", "accelerate") if actions == ACTION_SPACE else ("steer", "throttle", "brake"))
    assert exported.greatest < 1e-5
    assert exported.exceptions == 0
    assert_alike(model, tmp_path / "agent.onnx", Track.STATE)


@pytest.mark.parametrize(
    "options", [pytest.param({}, marks=pytest.mark.soak), {"policy_kwargs": {"squash_output": True}}]
)
def test_state_dependent_exploration(tmp_path, options):
    model = ppo(RandomTown(), use_sde=True, **options)
    export_sb3(saved(model, tmp_path / "agent.zip"), tmp_path / "agent.onnx")
    assert_alike(model, tmp_path / "agent.onnx", Track.STATE)


@pytest.mark.parametrize(
    "track", [Track.PRIVILEGED, *(pytest.param(one, marks=pytest.mark.soak) for one in ("camera", "segmentation"))]
)
def test_each_track_is_known_by_its_space(tmp_path, track):
    model = ppo(RandomTown(track, action_space()))
    exported = export_sb3(saved(model, tmp_path / "agent.zip"), tmp_path / "agent.onnx")
    assert exported.track == track
    assert_alike(model, tmp_path / "agent.onnx", track)


def test_a_policy_that_takes_some_keys_alone(tmp_path):
    whole = observation_space(Track.CAMERA).spaces
    small = {"policy_kwargs": {"features_extractor_kwargs": {"cnn_output_dim": 8}}}
    model = ppo(RandomTown(seen=spaces.Dict({"rgb": whole["rgb"], "speed": whole["speed"]})), **small)
    exported = export_sb3(saved(model, tmp_path / "agent.zip"), tmp_path / "agent.onnx")
    assert (exported.track, exported.inputs) == (Track.CAMERA, ("speed", "rgb"))
    assert_alike(model, tmp_path / "agent.onnx", Track.CAMERA)


def test_discrete_actions_drive_by_their_table(tmp_path):
    model = made(DQN("MultiInputPolicy", RandomTown(actions=spaces.Discrete(3)), **OFF_POLICY))
    file = saved(model, tmp_path / "agent.zip")
    rows = [[0.0, 0.5], [0.25, -1.0], [-0.25, 0.75]]
    (tmp_path / "actions.json").write_text(json.dumps(rows))
    export_sb3(file, tmp_path / "agent.onnx", actions=tmp_path / "actions.json")
    for observation, made_controls in driven(tmp_path / "agent.onnx", Track.STATE):
        chosen, _ = model.predict(observation, deterministic=True)
        np.testing.assert_array_equal(made_controls, controls(np.array(rows[int(chosen)])))

    for text, says in (
        (None, "--actions: is missing: the policy has 3 discrete actions; name a JSON list with"),
        ("[[0, 0.5], [0, 1]]", r"has shape \(2, 2\), and the policy 3 actions"),
        ("[[0], [0], [0]]", r"has shape \(3, 1\)"),
        ("[[0, 0.5], [0, -2], [0, 1]]", r"\[0.0, -2.0\] is out of range"),
        ("[[0, 0, 0], [0, -0.5, 1], [0, 1, 1]]", r"\[0.0, -0.5, 1.0\] is out of range"),
        ("[[0, 0.5], 3, 4]", "is not as it should be"),
        ("none", "is not as it should be"),
    ):
        table = None if text is None else tmp_path / "other.json"
        if table is not None and text is not None:
            table.write_text(text)
        with pytest.raises(TrainingError, match=says):
            export_sb3(file, tmp_path / "other.onnx", actions=table)
    with pytest.raises(TrainingError, match=r"--actions: \S*missing.json cannot be read"):
        export_sb3(file, tmp_path / "other.onnx", actions=tmp_path / "missing.json")
    box = saved(ppo(RandomTown()), tmp_path / "box.zip")
    with pytest.raises(TrainingError, match="--actions: is for discrete actions"):
        export_sb3(box, tmp_path / "other.onnx", actions=tmp_path / "actions.json")


@pytest.mark.parametrize(
    "pictures", [pytest.param(False, marks=pytest.mark.soak), True], ids=["numbers", "pictures too"]
)
def test_normalised_observations(tmp_path, pictures):
    env = DummyVecEnv([lambda: RandomTown(Track.CAMERA)])
    if pictures:
        env = VecNormalize(VecTransposeImage(env))
        model = ppo(env, policy_kwargs={"normalize_images": False})
    else:
        env = VecNormalize(env, norm_obs_keys=["speed", "steering", "command"], clip_obs=1.5)
        model = ppo(env)
    model.learn(24)
    file, statistics = saved(model, tmp_path / "agent.zip"), tmp_path / "stats.pkl"
    env.save(statistics)
    exported = export_sb3(file, tmp_path / "agent.onnx", vecnormalize=statistics)
    assert exported.greatest < 1e-4
    for observation, made_controls in driven(tmp_path / "agent.onnx", Track.CAMERA):
        given = dict(observation)
        if pictures:
            given["rgb"] = observation["rgb"].transpose(2, 0, 1)
        action, _ = model.predict(env.normalize_obs(given), deterministic=True)
        np.testing.assert_allclose(made_controls, controls(action), atol=1e-4)
    with pytest.raises(TrainingError, match=r"--vecnormalize"):
        export_sb3(file, tmp_path / "other.onnx")


def test_statistics_that_do_not_fit(tmp_path):
    file = saved(ppo(RandomTown(Track.CAMERA)), tmp_path / "agent.zip")
    missing = tmp_path / "missing.pkl"
    with pytest.raises(TrainingError, match=r"--vecnormalize: \S*missing.pkl cannot be read"):
        export_sb3(file, tmp_path / "agent.onnx", vecnormalize=missing)
    with pytest.raises(TrainingError, match=r"--vecnormalize: \S*agent.zip is not what VecNormalize.save wrote"):
        export_sb3(file, tmp_path / "agent.onnx", vecnormalize=file)
    flat = VecNormalize(DummyVecEnv([lambda: RandomTown(seen=observation_space(Track.STATE)["speed"])]))
    flat.save(tmp_path / "flat.pkl")
    with pytest.raises(TrainingError, match="--vecnormalize: its statistics are not of a Dict"):
        export_sb3(file, tmp_path / "agent.onnx", vecnormalize=tmp_path / "flat.pkl")
    assert not (tmp_path / "agent.onnx").exists()


def wrapped(name: str):
    """Return an environment that is not ours, by what is wrong with it."""
    whole = observation_space(Track.CAMERA).spaces
    pose = observation_space(Track.PRIVILEGED)["pose"]
    return {
        "other key": RandomTown(seen=spaces.Dict({**whole, "sonar": spaces.Box(0, 1, (3,))})),
        "two tracks": RandomTown(seen=spaces.Dict({"rgb": whole["rgb"], "pose": pose})),
        "scaled": RandomTown(seen=spaces.Dict({"speed": spaces.Box(0, 1, (1,))})),
        "actions": RandomTown(actions=spaces.Box(-1, 1, (3,))),
    }[name]


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("other key", "sonar: no such observation key; train on an environment of one track"),
        ("two tracks", "no track has all of these keys"),
        ("scaled", r"speed is Box\(0.0, 1.0.*a wrapper changed it; give --vecnormalize, or train without the wrapper"),
        ("actions", r"action space: Box\(-1.0, 1.0, \(3,\), float32\) is none of ours"),
    ],
)
def test_spaces_that_are_not_ours(tmp_path, name, says):
    """Those that are stacked, flat or of another size: test_sb3_agent.py."""
    file = saved(ppo(wrapped(name)), tmp_path / "agent.zip")
    with pytest.raises(TrainingError, match=says):
        export_sb3(file, tmp_path / "agent.onnx")


class Foreign(BasePolicy):
    """A policy of an algorithm that is not supported."""

    def _predict(self, observation, deterministic=False):
        raise NotImplementedError


def test_an_algorithm_that_is_not_supported(tmp_path):
    town = RandomTown()
    data = {
        "policy_class": Foreign,
        "policy_kwargs": {},
        "observation_space": town.observation_space,
        "action_space": town.action_space,
    }
    save_to_zip_file(tmp_path / "agent.zip", data, {"policy": {}})
    with pytest.raises(
        TrainingError, match="its policy is a Foreign; the policies of PPO, A2C, SAC, TD3, DDPG and DQN"
    ):
        export_sb3(tmp_path / "agent.zip", tmp_path / "agent.onnx")


def test_a_network_that_no_graph_can_hold(tmp_path):
    file = saved(ppo(RandomTown(), policy_kwargs={"features_extractor_class": Branches}), tmp_path / "agent.zip")
    with pytest.raises(TrainingError, match=r"torch cannot export the network: .*written with torch.where"):
        export_sb3(file, tmp_path / "agent.onnx")


def test_a_file_that_does_not_drive_as_its_policy_is_not_written(tmp_path):
    (tmp_path / "agent.onnx").write_text("kept")
    file = saved(ppo(RandomTown(), policy_kwargs={"features_extractor_class": Draws}), tmp_path / "agent.zip")
    with pytest.raises(TrainingError, match=r"on \d+ of 200 sampled observations the file's action differs"):
        export_sb3(file, tmp_path / "agent.onnx")
    assert (tmp_path / "agent.onnx").read_text() == "kept"
    assert {path.name for path in tmp_path.iterdir()} == {"agent.onnx", "agent.zip"}


def test_weights_that_are_not_finite(tmp_path):
    model = ppo(RandomTown())
    model.policy.action_net.bias.data[0] = float("nan")
    with pytest.raises(TrainingError, match=r"action_net.bias: is not finite"):
        export_sb3(saved(model, tmp_path / "agent.zip"), tmp_path / "agent.onnx")


def test_the_command_says_what_it_made_and_warns(tmp_path):
    file = saved(ppo(RandomTown(), policy_kwargs={"features_extractor_class": Extractor}), tmp_path / "agent.zip")
    out = tmp_path / "my driver.onnx"
    done = CliRunner().invoke(app, ["export", "sb3", str(file), "--out", str(out), "--description", "A try."])
    assert done.exit_code == 0, done.output
    assert "runs code that is named inside: export only files that you trust" in done.stderr
    assert "PPO, state track" in done.stdout
    assert "takes speed, steering; gives steer, accelerate" in done.stdout
    assert "On 200 sampled observations its actions differ from the policy's by" in done.stdout
    source = resolve(str(out))
    assert (source.name, source.description) == ("my driver", "A try.")
    assert str(tmp_path).encode() not in out.read_bytes()


def test_what_cannot_be_is_told_before_anything_is_loaded(tmp_path):
    done = CliRunner().invoke(app, ["export", "sb3", str(tmp_path / "missing.zip"), "--out", str(tmp_path / "a.onnx")])
    assert "there is no such file; name what model.save wrote" in str(done.exception)
    assert "runs code" not in done.output
    for out, options, says in (
        (tmp_path / "agent.pt", {}, "--out: .* does not end with .onnx"),
        (tmp_path / "none" / "agent.onnx", {}, "--out: .* a directory that exists"),
        (tmp_path / "agent.onnx", {"name": "\n"}, "--name: '.n' cannot be one"),
    ):
        with pytest.raises(TrainingError, match=says):
            export_sb3(tmp_path / "missing.zip", out, **options)


OWN = """
from sb3_policies import Extractor

class Mine(Extractor):
    pass
"""


def test_an_own_features_extractor_is_imported_from_the_working_directory(tmp_path, monkeypatch):
    (tmp_path / "my_extractor.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    from my_extractor import Mine

    saved(ppo(RandomTown(), policy_kwargs={"features_extractor_class": Mine}), tmp_path / "agent.zip")
    command = ["export", "sb3", str(tmp_path / "agent.zip"), "--out", str(tmp_path / "agent.onnx")]
    sys.path.remove(str(tmp_path))
    monkeypatch.delitem(sys.modules, "my_extractor")
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    assert resolve(str(tmp_path / "agent.onnx")).track is Track.STATE
    (tmp_path / "my_extractor.py").rename(tmp_path / "hidden.py")
    monkeypatch.delitem(sys.modules, "my_extractor")
    done = CliRunner().invoke(app, ["export", "sb3", str(tmp_path / "agent.zip"), "--out", str(tmp_path / "a.onnx")])
    assert "needs the module my_extractor, which cannot be imported" in str(done.exception)
    assert "start in the folder of your module" in str(done.exception)


def test_without_torch_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    done = CliRunner().invoke(app, ["export", "sb3", "agent.zip", "--out", str(tmp_path / "agent.onnx")])
    assert "torch is not installed" in str(done.exception)
    assert install("wrongturn-agents[training]") in str(done.exception)


def test_the_kinds_of_export_are_listed_and_a_checkpoint_needs_no_word(tmp_path):
    shown = CliRunner().invoke(app, ["export", "--help"]).output
    assert "sb3" in shown
    assert "checkpoint" in shown
    missing = str(tmp_path / "missing.pt")
    for words in (["export"], ["export", "checkpoint"]):
        done = CliRunner().invoke(app, [*words, missing, str(tmp_path / "a.onnx")])
        assert isinstance(done.exception, TrainingError)
        assert "checkpoint" in str(done.exception)
    assert "No such option" in CliRunner().invoke(app, ["export", missing, "a.onnx", "--nothing"]).output
    precise = CliRunner().invoke(app, ["export", "--precision", "fp16", missing, str(tmp_path / "a.onnx")])
    assert isinstance(precise.exception, TrainingError)
