import numpy as np
import pytest

from wrongturn_protocol import OptionError
from wrongturn_protocol.observations import observation_space
from wrongturn_sim import WrongturnVectorEnv

sb3 = pytest.importorskip("stable_baselines3")

from wrongturn_agents.training import WrongturnVecEnv  # noqa: E402


def test_it_gives_what_the_vectorised_environment_gives():
    ours = WrongturnVecEnv(4, town="junctions", track="privileged")
    envs = WrongturnVectorEnv(4, town="junctions", track="privileged", autoreset_mode="SameStep")
    assert ours.observation_space == observation_space(envs.track)
    ours.seed(7)
    seen, (expected, infos) = ours.reset(), envs.reset(seed=7)
    assert [info["trial"] for info in ours.reset_infos] == infos["trial"].tolist()
    random = np.random.default_rng(1)
    ends = 0
    for _ in range(120):
        for name, array in expected.items():
            assert array.tobytes() == seen[name].tobytes()
        actions = random.uniform([-0.4, 0.2, 0.0], [0.1, 0.9, 0.1], (4, 3)).astype(np.float32)
        seen, rewards, dones, told = ours.step(actions)
        expected, wanted, terminated, truncated, infos = envs.step(actions)
        assert (dones == (terminated | truncated)).all()
        assert rewards.dtype == np.float32
        assert (rewards == wanted.astype(np.float32)).all()
        for i, info in enumerate(told):
            assert bool(info) is bool(dones[i])
            if dones[i]:
                ends += 1
                last = infos["final_obs"][i]
                assert set(info["terminal_observation"]) == set(last)
                assert all((info["terminal_observation"][name] == last[name]).all() for name in last)
                assert info["verdict"] == info["outcome"]["verdict"] == infos["final_info"]["verdict"][i]
                assert info["TimeLimit.truncated"] is bool(truncated[i])
                assert info["trial"] == infos["trial"][i]
    assert ends > 4
    ours.close()


def test_attributes_and_methods():
    envs = WrongturnVecEnv(3, town="junctions")
    envs.reset()
    assert [trial.town for trial in envs.get_attr("trials")] == ["junctions"] * 3
    assert envs.get_attr("steps", indices=[0, 2]) == [0, 0]
    assert [record.outcome for record in envs.env_method("episode", indices=1)] == [None]
    assert envs.env_is_wrapped(object) == [False] * 3
    assert envs.get_attr("render_mode") == [None] * 3
    with pytest.raises(NotImplementedError, match="track"):
        envs.set_attr("track", "camera")
    with pytest.raises(RuntimeError, match="step_async"):
        envs.step_wait()


def test_it_renders_the_pictures_of_the_batch():
    envs = WrongturnVecEnv(2, town="junctions", render_mode="rgb_array")
    envs.reset()
    assert envs.render().shape == (960, 864, 3)
    assert np.array_equal(envs.get_images(), envs.envs.render())
    assert WrongturnVecEnv(2, town="junctions").get_images() == [None, None]
    envs.close()


def test_only_same_step_is_taken():
    assert WrongturnVecEnv(2, town="junctions", autoreset_mode="SameStep").num_envs == 2
    with pytest.raises(OptionError, match=r"^autoreset_mode: is NextStep; .* needs SameStep, so leave it out$"):
        WrongturnVecEnv(2, town="junctions", autoreset_mode="NextStep")


def test_a_trial_by_the_options():
    envs = WrongturnVecEnv(2, suite="smoke@3")
    envs.set_options({"trial": WrongturnVectorEnv(1, suite="smoke@3").reset(seed=1)[1]["trial"][0]})
    envs.reset()
    assert len({info["trial"] for info in envs.reset_infos}) == 1
    envs.set_options([{"trial": "a"}, {}])
    with pytest.raises(ValueError, match="options"):
        envs.reset()
