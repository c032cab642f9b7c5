"""The wrappers, on environments in process; tests/idioms has those of other projects."""

import math
import re
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.wrappers.vector import VectorizeTransformAction, VectorizeTransformObservation

import wrongturn_client.wrappers
import wrongturn_protocol.wrappers
import wrongturn_sim.wrappers
from wrongturn_protocol import SegmentationClass
from wrongturn_sim.wrappers import (
    CarFrame,
    DiscreteActions,
    GrayPicture,
    OnlyPicture,
    ResizePictures,
    SegmentationPlanes,
    ShapeReward,
    StackPictures,
    SteerAndPedal,
    WrappedAgent,
)

ID = "wrongturn_sim:WrongturnSim-v0"
PAGE = Path(__file__).parents[2] / "docs" / "wrappers.md"
GAS = np.float32([0.1, 0.6, 0.0])
WRAPPED = pytest.mark.filterwarnings("ignore:.*different from the unwrapped version")
"""Gymnasium's checker wants environments without wrappers."""


def make(track="state", **more):
    return gymnasium.make(ID, town="junctions", track=track, **more)


@pytest.fixture(scope="module")
def seeing():
    """One environment for those who look at pictures; each begins it anew."""
    return make("segmentation")


@pytest.fixture(scope="module")
def plain(seeing):
    """Its observations: the first, and that after a step."""
    return [seeing.reset(seed=3)[0], seeing.step(GAS)[0]]


def driven(env, action=GAS):
    return [env.reset(seed=3)[0], env.step(action)[0]]


def test_each_part_gives_the_same_names():
    for module in (wrongturn_client.wrappers, wrongturn_sim.wrappers):
        assert {name: getattr(module, name) for name in module.__all__} == {
            name: getattr(wrongturn_protocol.wrappers, name) for name in wrongturn_protocol.wrappers.__all__
        }


@pytest.mark.parametrize(
    "wrap",
    [
        DiscreteActions,
        lambda env: DiscreteActions(env, [(0, 1, 0), (0, 0, 1)]),
        SteerAndPedal,
        GrayPicture,
        SegmentationPlanes,
        StackPictures,
        lambda env: ResizePictures(env, (32, 48)),
        lambda env: OnlyPicture(env, "segmentation"),
        lambda env: OnlyPicture(StackPictures(GrayPicture(ResizePictures(SteerAndPedal(env), (84, 84))), 2)),
        lambda env: ShapeReward(env, lambda reward, seen, info: reward / 100),
    ],
)
@WRAPPED
def test_gymnasiums_checker_and_the_spec(seeing, wrap):
    env = wrap(seeing)
    check_env(env, skip_render_check=True)
    assert env.spec.additional_wrappers[-1].entry_point.startswith("wrongturn_protocol.wrappers")


def test_actions_from_a_list():
    env = DiscreteActions(make(), [(0, 1, 0), (-1, 0, 0.5)])
    env.reset(seed=1)
    env.step(0)
    env.step(np.int64(1))
    row = env.unwrapped.episode.trajectory.rows[-1]
    assert (row.steer, row.throttle, row.brake) == (-1, 0, 0.5)
    assert DiscreteActions(make()).action_space.n == 15
    for action in (2, -1, 0.5, "left", None, [0, 1]):
        with pytest.raises(ValueError, match="give 0 to 1"):
            env.step(action)
    for actions, named in (
        ([], "actions: the list is empty"),
        (5, "actions: 5 is no list"),
        ([0, 1], "is no list"),
        ([(0, 1)], r"actions\[0\]"),
        ([(0, 1, 0), (0, 2, 0)], r"actions\[1\]"),
        ([(0, 0, math.nan)], r"actions\[0\]"),
        ([("left", 0, 0)], r"actions\[0\]"),
    ):
        with pytest.raises(ValueError, match=named):
            DiscreteActions(make(), actions)


def test_steering_and_one_pedal():
    env = SteerAndPedal(make())
    env.reset(seed=1)
    for action, wanted in (([0.5, 0.25], (0.5, 0.25, 0)), ([-1, -1], (-1, 0, 1)), (np.zeros(2), (0, 0, 0))):
        env.step(action)
        row = env.unwrapped.episode.trajectory.rows[-1]
        assert (row.steer, row.throttle, row.brake) == wanted
    for action in ([0.5], [0, 0, 0], "left", None):
        with pytest.raises(ValueError, match="give steer and pedal"):
            env.step(action)
    with pytest.raises(ValueError, match="SteerAndPedal: actions of this environment are Discrete"):
        SteerAndPedal(DiscreteActions(make()))


def test_grey(seeing, plain):
    for seen, was in zip(driven(GrayPicture(seeing)), plain, strict=True):
        assert seen["rgb"].shape == (64, 192, 1)
        weighed = was["rgb"].astype(float) @ [0.299, 0.587, 0.114]
        assert np.abs(seen["rgb"][..., 0] - weighed).max() <= 1
        assert np.array_equal(seen["segmentation"], was["segmentation"])


def test_another_size(seeing, plain):
    for seen, was in zip(driven(ResizePictures(seeing, (32, 96))), plain, strict=True):
        blocks = was["rgb"].reshape(32, 2, 96, 2, 3).mean((1, 3))
        assert np.abs(seen["rgb"] - blocks).max() <= 1
        assert set(np.unique(seen["segmentation"])) <= set(np.unique(was["segmentation"]))
    for shape in (32, (32,), (0, 10), (1.5, 2), "ab"):
        with pytest.raises(ValueError, match="shape"):
            ResizePictures(seeing, shape)


def test_a_plane_for_each_class(seeing, plain):
    for seen, was in zip(driven(SegmentationPlanes(seeing)), plain, strict=True):
        planes = seen["segmentation"]
        assert planes.shape == (64, 192, len(SegmentationClass))
        assert np.array_equal(planes.argmax(-1), was["segmentation"])
        assert set(np.unique(planes)) == {0, 255}
        assert (planes.astype(int).sum(-1) == 255).all()


def test_pictures_stacked_over_time(seeing, plain):
    first, second = driven(StackPictures(seeing, 3))
    assert np.array_equal(first["rgb"], np.dstack([plain[0]["rgb"]] * 3))
    assert np.array_equal(second["rgb"], np.dstack([plain[0]["rgb"]] * 2 + [plain[1]["rgb"]]))
    assert second["segmentation"].shape == (64, 192, 3)
    assert second["speed"] == plain[1]["speed"]
    with pytest.raises(ValueError, match="number"):
        StackPictures(seeing, 0)


def test_a_picture_and_nothing_else(seeing, plain):
    assert np.array_equal(driven(OnlyPicture(seeing))[1], plain[1]["rgb"])
    with pytest.raises(ValueError, match="no picture 'speed'; give one of rgb, segmentation"):
        OnlyPicture(seeing, "speed")


@pytest.mark.parametrize("wrapper", [OnlyPicture, GrayPicture, SegmentationPlanes, StackPictures])
def test_what_has_no_pictures_says_so(wrapper, seeing):
    for env in (make(), OnlyPicture(seeing)):
        with pytest.raises(ValueError, match=f"{wrapper.__name__}: observations have no pictures"):
            wrapper(env)


def test_a_wrong_order_says_so(seeing):
    with pytest.raises(ValueError, match="put it before StackPictures"):
        GrayPicture(StackPictures(seeing))
    with pytest.raises(ValueError, match="put it before StackPictures"):
        SegmentationPlanes(StackPictures(seeing))
    with pytest.raises(ValueError, match="track='privileged'"):
        CarFrame(seeing)


@WRAPPED
def test_the_privileged_track_as_the_car_sees_it():
    env = CarFrame(make("privileged", traffic={"vehicles": 8}))
    check_env(env, skip_render_check=True)
    env.reset(seed=1)
    for _ in range(30):
        seen, _, over, _, _ = env.step(np.float32([0.3, 0.5, 0]))
        if over:
            break
    assert "pose" not in seen
    distances = np.hypot(seen["lane"][:, 0], seen["lane"][:, 1])
    assert distances.min() < 5
    assert np.allclose(np.hypot(*np.diff(seen["lane"][:5], axis=0).T), 1, atol=0.05), "metres stay metres"


def test_points_are_ahead_and_to_the_left():
    env = CarFrame(make("privileged"))
    seen = env.unwrapped.observation_space.sample()
    seen["pose"][:] = 10.0, 20.0, math.pi / 2  # looks north
    seen["lane"][:] = 10.0, 23.0  # 3 m ahead
    seen["exits"][:] = 6.0, 20.0  # 4 m to the left
    seen["exits_mask"][:] = 1, 0, 1
    seen["road_users_count"][:] = 1
    seen["road_users"][:] = 0
    seen["road_users"][0] = 10.0, 10.0, -math.pi, 4.6, 1.9, 5.0
    turned = env.observation(seen)
    assert np.allclose(turned["lane"], [3, 0], atol=1e-5)
    assert np.allclose(turned["exits"][0], [0, 4], atol=1e-5)
    assert not turned["exits"][1].any()
    assert np.allclose(turned["road_users"][0], [-10, 0, math.pi / 2, 4.6, 1.9, 5], atol=1e-5)
    assert not turned["road_users"][1:].any()
    assert turned in env.observation_space
    assert seen["lane"][0].tolist() == [10, 23], "the observation that came in is left alone"


def test_a_reward_of_ones_own():
    given = []

    def wary(reward, seen, info):
        given.append((reward, seen, info))
        return reward / 100 - (10 if info.get("verdict") == "off_road" else 0) + float(seen["speed"][0])

    env = ShapeReward(make(), wary)
    env.reset(seed=1)
    over = False
    while not over:
        seen, reward, terminated, truncated, info = env.step(np.float32([1, 1, 0]))
        over = terminated or truncated
        assert given[-1][1:] == (seen, info)
        assert reward == pytest.approx(wary(*given.pop()))
    assert info["verdict"] == "off_road"
    for function in (lambda *_: None, lambda *_: math.nan, lambda *_: "much"):
        env = ShapeReward(make(), function)
        env.reset(seed=1)
        with pytest.raises(ValueError, match="return a finite number"):
            env.step(GAS)
    with pytest.raises(ValueError, match="function: 3 is no function"):
        ShapeReward(make(), 3)


def test_a_whole_batch_behind_wrappers():
    envs = gymnasium.make_vec(ID, num_envs=3, town="junctions", track="camera")
    envs = VectorizeTransformObservation(envs, wrapper=GrayPicture)
    envs = VectorizeTransformAction(envs, wrapper=DiscreteActions)
    envs.reset(seed=3)
    seen, *_ = envs.step([0, 7, 14])
    envs.close()
    assert envs.single_action_space.n == 15
    for i, action in enumerate([0, 7, 14]):
        env = DiscreteActions(GrayPicture(make("camera")))
        env.reset(seed=3 + i)
        alone, *_ = env.step(action)
        assert np.array_equal(seen["rgb"][i], alone["rgb"])


def test_an_agent_behind_wrappers_acts_as_the_wrapped_environment():
    """The service's side is played by a plain environment that gets what the agent answers."""

    def wrap(env):
        return StackPictures(GrayPicture(SteerAndPedal(env)), 2)

    def policy(seen):
        return np.float32([0.1 * seen["rgb"].std() / 128, 0.5])

    env, driven = wrap(make("camera")), {}
    for seed in (3, 4):
        seen, _ = env.reset(seed=seed)
        for _ in range(4):
            seen, *_ = env.step(policy(seen))
        driven[seed] = env.unwrapped.episode.trajectory.sha256
    service = make("camera")
    agent = WrappedAgent(policy, wrap)
    with pytest.raises(ValueError, match="call reset"):
        agent.act({})
    for seed in (3, 4):
        plain, _ = service.reset(seed=seed)
        agent.reset(service.observation_space)
        for _ in range(4):
            plain, *_ = service.step(agent.act(plain))
        assert service.unwrapped.episode.trajectory.sha256 == driven[seed]
    agent = WrappedAgent(policy, lambda env: gymnasium.wrappers.RepeatAction(wrap(env), 4))
    agent.reset(service.observation_space)
    agent.act(plain)
    with pytest.raises(ValueError, match="more than one step"):
        agent.act(plain)
    sticky = WrappedAgent(policy, lambda env: gymnasium.wrappers.StickyAction(wrap(env), 0.25))
    with pytest.raises(ValueError, match="wrap: StickyAction changes actions at random"):
        sticky.reset(service.observation_space)


@pytest.mark.parametrize(("variant", "actions"), [("Flat", "Box"), ("FlatDiscrete", "Discrete")])
def test_ids_with_wrappers_in_them(variant, actions):
    env = gymnasium.make(f"wrongturn_sim:WrongturnSim{variant}-v0", town="junctions")
    seen, _ = env.reset(seed=1)
    assert seen.size > 600
    assert type(env.action_space).__name__ == actions
    assert gymnasium.make(env.spec).spec == env.spec
    with pytest.raises(ValueError, match="track='privileged'"):
        gymnasium.make(f"wrongturn_sim:WrongturnSim{variant}-v0", town="junctions", track="state")


def test_the_page_runs_as_it_stands(capsys):
    pytest.importorskip("stable_baselines3")
    examples = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(examples) == 5
    page = {}
    exec("\n".join(examples), page)
    assert capsys.readouterr().out == "(84, 84, 4) (2,)\n"
    plain, _ = make("privileged").reset(seed=1)
    page["agent"].reset(make("privileged").observation_space)
    assert page["agent"].act(plain).shape == (3,)


def test_the_page_names_each_wrapper():
    named = set(re.findall(r"`(\w+)[`(]", PAGE.read_text(encoding="utf-8")))
    assert set(wrongturn_sim.wrappers.__all__) <= named
