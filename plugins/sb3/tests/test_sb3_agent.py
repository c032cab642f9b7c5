"""A policy of Stable-Baselines3 drives as it predicts, or the run says why it cannot before anything begins."""

import re
import zipfile

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import FlattenObservation
from sb3_policies import Extractor, RandomTown, made, ppo, saved
from stable_baselines3 import A2C, DQN, PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecNormalize

from wrongturn_agents import cli, resolve
from wrongturn_agents.errors import AgentFailedError, MissingPackageError, ModelFileError
from wrongturn_agents.training.action import ACTION_SPACE, controls
from wrongturn_protocol import AgentKind, Track
from wrongturn_protocol.installing import install
from wrongturn_protocol.observations import action_space, observation_space
from wrongturn_protocol.wrappers import CarFrame, DiscreteActions, SteerAndPedal


@pytest.mark.parametrize(("track", "actions"), [(Track.CAMERA, ACTION_SPACE), (Track.PRIVILEGED, action_space())])
def test_it_drives_as_the_policy_predicts(tmp_path, track, actions):
    model = ppo(RandomTown(track, actions))
    source = resolve(str(saved(model, tmp_path / "driver.zip")))
    assert (source.name, source.track, source.kind) == ("driver", track, AgentKind.SUBMITTED)
    assert source.description == "Learned by PPO of Stable-Baselines3."
    agent = source.make()
    agent.reset(observation_space(track))
    rows = sampled(track)
    assert agent.act_batch({key: np.stack([row[key] for row in rows]) for key in rows[0]}) == [*map(agent.act, rows)]
    for observation in rows:
        action = agent.act(observation)
        wanted, _ = model.predict(observation, deterministic=True)
        wanted = controls(wanted) if actions == ACTION_SPACE else wanted
        np.testing.assert_allclose((action.steer, action.throttle, action.brake), wanted, atol=1e-6)


def test_a_policy_that_sees_the_picture_alone(tmp_path):
    town = RandomTown(seen=observation_space(Track.CAMERA)["rgb"], actions=action_space())
    model = made(PPO("CnnPolicy", town, n_steps=8, batch_size=8, device="cpu", seed=1))
    source = resolve(str(saved(model, tmp_path / "sees.zip")))
    assert source.track is Track.CAMERA
    for observation in sampled(Track.CAMERA):
        action = source.make().act(observation)
        wanted, _ = model.predict(observation["rgb"], deterministic=True)
        np.testing.assert_allclose((action.steer, action.throttle, action.brake), wanted, atol=1e-6)


def sampled(track: Track) -> list[dict[str, np.ndarray]]:
    space = observation_space(track)
    space.seed(5)
    return [space.sample() for _ in range(3)]


def test_a_file_that_changes_is_another_agent(tmp_path):
    file = saved(ppo(RandomTown()), tmp_path / "agent.zip")
    assert resolve(str(file)).code == (file,)


def flat_variant(name: str) -> gymnasium.Env:
    """Return what the id with this name in it shows and takes."""
    env = FlattenObservation(CarFrame(RandomTown(Track.PRIVILEGED, action_space())))
    return DiscreteActions(env) if name == "FlatDiscrete" else SteerAndPedal(env)


def unfit(name: str):
    """Return a model that cannot be run as it is, by what is wrong with it."""
    camera, state = RandomTown(Track.CAMERA), RandomTown()
    if name == "normalised":
        model = ppo(VecNormalize(DummyVecEnv([lambda: state]), norm_obs_keys=["speed"]))
        return model.learn(8)
    if name == "discrete":
        town = RandomTown(actions=spaces.Discrete(3))
        return DQN("MultiInputPolicy", town, buffer_size=10, device="cpu")
    if name == "flat":
        return PPO("MlpPolicy", FlattenObservation(state), device="cpu")
    if name.startswith("Flat"):
        return A2C("MlpPolicy", flat_variant(name), device="cpu")
    if name == "another":
        bounds = np.arange(40, dtype=np.float32)
        return PPO("MlpPolicy", RandomTown(seen=spaces.Box(bounds * 0, bounds)), device="cpu")
    whole = camera.observation_space.spaces
    small = spaces.Dict({**whole, "rgb": spaces.Box(0, 255, (48, 48, 3), np.uint8)})
    return ppo({"stacked": VecFrameStack(DummyVecEnv([lambda: camera]), 4), "small": RandomTown(seen=small)}[name])


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("normalised", r"needs more than the file: --vecnormalize: .*wrongturn_client export sb3 \S+ --out agent.onnx"),
        ("discrete", r"needs more than the file: --actions: .*then '.* run agent.onnx'"),
        ("flat", r"trained on \d+ numbers \(FlattenObservation\); drive it with WrappedAgent, see docs/wrappers.md$"),
        ("Flat", r"680 numbers \(CarFrame and FlattenObservation\); drive it with WrappedAgent, see docs/wrappers.md$"),
        ("FlatDiscrete", r"680 numbers \(CarFrame and FlattenObservation\); drive it with WrappedAgent"),
        ("another", r"observation space: Box\(0.0 to 39.0, \(40,\), float32\) is not one of ours.*a MultiInputPolicy"),
        ("stacked", "speed is .*4 frames stacked"),
        ("small", r"rgb is \(3, 48, 48\), and the service shows \(64, 192, 3\)"),
    ],
)
def test_what_does_not_fit_is_told_before_a_service_starts(tmp_path, name, says, monkeypatch, capsys):
    monkeypatch.delenv("WRONGTURN_URL", raising=False)
    monkeypatch.setattr("wrongturn_agents.worker.LocalService", lambda **_: pytest.fail("a service was started"))
    file = saved(unfit(name), tmp_path / "agent.zip")
    with pytest.raises(ModelFileError, match=says):
        cli.run([str(file)], suite="smoke@3")
    assert f"Loading {file} runs code that is named inside: run only files that you trust." in capsys.readouterr().err


class Stumbles(Extractor):
    """Fails on what it sees."""

    def forward(self, observation):
        raise ZeroDivisionError("no speed")


def test_a_policy_that_fails_begins_nothing(tmp_path, monkeypatch):
    monkeypatch.delenv("WRONGTURN_URL", raising=False)
    monkeypatch.setattr("wrongturn_agents.worker.LocalService", lambda **_: pytest.fail("a service was started"))
    file = saved(ppo(RandomTown(), policy_kwargs={"features_extractor_class": Stumbles}), tmp_path / "agent.zip")
    with pytest.raises(AgentFailedError, match=r"agent: agent.act raised ZeroDivisionError: no speed"):
        cli.run([str(file)], suite="smoke@3")


def test_files_that_are_no_model(tmp_path):
    (tmp_path / "folder.zip").mkdir()
    (tmp_path / "empty.zip").touch()
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as archive:
        archive.writestr("a.txt", "b")
    whole = saved(ppo(RandomTown()), tmp_path / "whole.zip").read_bytes()
    (tmp_path / "cut.zip").write_bytes(whole[:-300])
    for name, says in (
        ("missing", "there is no such file"),
        ("folder", "is no file"),
        ("empty", "is no zip file, or a damaged one"),
        ("other", "is a zip file of something else"),
        ("cut", "or a damaged one"),
    ):
        file = tmp_path / f"{name}.zip"
        with pytest.raises(ModelFileError, match=f"{re.escape(str(file))}.*{says}"):
            resolve(str(file))


def test_without_the_extra_it_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "agent.zip").touch()
    monkeypatch.setattr("wrongturn_agents.registry.FILES", "nobody.drives")
    advice = re.escape(install("wrongturn-agents[training]"))
    with pytest.raises(MissingPackageError, match=f"needs wrongturn-sb3; install it with: {advice}"):
        resolve(str(tmp_path / "agent.zip"))
