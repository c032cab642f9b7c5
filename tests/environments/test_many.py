"""What every environment promises that drives many trials at once: above all, what single ones do, byte for byte."""

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from kinds import GAS, Environments, same

from wrongturn_networks import load_suite
from wrongturn_protocol import Action, OptionError, Track
from wrongturn_protocol.observations import observation_space


def gas(number: int) -> Any:
    return np.tile(GAS, (number, 1))


def drawn_actions(count: int, steps: int, seed: int = 3) -> Any:
    """(steps, count, 3): some wander off, some brake to a stand, some go straight on and reach an exit."""
    random = np.random.default_rng(seed)
    actions = np.zeros((steps, count, 3), np.float32)
    bias = random.choice([0.0, 0.0, -0.3, 0.2], count)
    actions[..., 0] = np.clip(bias + random.normal(0, 0.2, (steps, count)) * (random.random(count) < 0.5), -1, 1)
    actions[..., 1] = random.uniform(0.1, 0.9, (steps, count))
    stops = np.where(random.random(count) < 0.4, random.integers(5, 40, count), steps)
    actions[..., 2] = np.arange(steps)[:, None] > stops
    return actions


def alone(kind: Environments, actions: Any, seed: int, mode: AutoresetMode, **options: Any) -> list[list[Any]]:
    """What single environments give under the same autoreset mode, a list of steps for each."""
    env: Any = kind.one(**options)
    turns = []
    for i in range(actions.shape[1]):
        observation, info = env.reset(seed=seed + i)
        mine: list[Any] = [(observation, 0.0, False, False, info, None)]
        over = False
        for action in actions[:, i]:
            if over:
                observation, info = env.reset()
                mine.append((observation, 0.0, False, False, info, None))
                over = False
                continue
            observation, reward, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            final = None
            if over:
                record = None if kind.is_remote else (env.episode.trajectory.sha256, env.episode.actions_sha256)
                final = (observation, info, record)
                if mode is AutoresetMode.SAME_STEP:
                    observation, info = env.reset()
                    over = False
            mine.append((observation, reward, terminated, truncated, info, final))
        turns.append(mine)
    return turns


def compare(
    kind: Environments,
    actions: Any,
    mode: AutoresetMode = AutoresetMode.NEXT_STEP,
    seed: int = 5,
    threads: int = 1,
    **options: Any,
) -> list[str]:
    """Drive both and compare every byte; return the verdicts that fell."""
    count = actions.shape[1]
    turns = alone(kind, actions, seed, mode, **options)
    envs = kind.many(count, autoreset_mode=mode, **options, **({} if kind.is_remote else {"threads": threads}))
    observation, infos = envs.reset(seed=seed)
    verdicts = []
    for i in range(count):
        same(turns[i][0][0], observation, i)
        assert infos["trial"][i] == turns[i][0][4]["trial"]
    for step, action in enumerate(actions, start=1):
        observation, rewards, terminated, truncated, infos = envs.step(action)
        for i in range(count):
            seen, reward, *ended, info, final = turns[i][step]
            same(seen, observation, i)
            assert np.float64(reward).tobytes() == rewards[i].tobytes()
            assert ended == [terminated[i], truncated[i]]
            if final is None:
                assert not infos.get("_verdict", np.zeros(count, bool))[i]
                assert bool(infos.get("_trial", np.zeros(count, bool))[i]) == ("trial" in info)
                continue
            last, told, record = final
            verdicts.append(told["verdict"])
            if mode is AutoresetMode.SAME_STEP:
                same(last, {name: array[None] for name, array in infos["final_obs"][i].items()}, 0)
                assert infos["final_info"]["verdict"][i] == told["verdict"]
                assert infos["trial"][i] == info["trial"]
                continue
            assert infos["verdict"][i] == told["verdict"]
            if record is not None:
                kept = envs.unwrapped.episode(i)
                assert kept.outcome.model_dump(mode="json", exclude_none=True) == told["outcome"]
                assert infos["outcome"][i] == told["outcome"]
                assert (kept.trajectory.sha256, kept.actions_sha256) == record
    return verdicts


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_a_batch_is_what_single_environments_are(kind: Environments, mode: AutoresetMode) -> None:
    number, steps = (2, 80) if kind.is_remote else (8, 120)
    verdicts = compare(kind, drawn_actions(number, steps), mode, track="privileged", fault="omission", threads=2)
    assert verdicts


@pytest.mark.parametrize("track", list(Track))
def test_what_is_shown_is_the_track(kind: Environments, track: Track) -> None:
    if track is Track.WORDS and not kind.is_remote:
        with pytest.raises(OptionError, match="track: a batch has no sentences"):
            kind.many(2, track=track)
        return
    envs = kind.many(2, track=track)
    assert envs.single_observation_space == observation_space(track)
    first, infos = envs.reset(seed=1)
    assert envs.observation_space.contains(first)
    assert infos["_trial"].all()
    assert infos["town"].tolist() == ["junctions"] * 2
    observation, rewards, terminated, truncated, infos = envs.step(gas(2))
    assert envs.observation_space.contains(observation)
    assert rewards.dtype == np.float64
    assert not (terminated | truncated).any()
    assert infos == {}
    again, _ = envs.reset(seed=[1, 2])
    for i in range(2):
        same({name: array[i] for name, array in first.items()}, again, i)


def test_gymnasium_makes_it(kind: Environments) -> None:
    envs = kind.many(2, autoreset_mode="SameStep")
    assert envs.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert type(envs.unwrapped).metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert envs.metadata["render_modes"] == ["rgb_array"]
    envs = kind.many(2, vectorization_mode="sync")
    envs.reset(seed=42)
    assert envs.step(envs.action_space.sample())[0]["speed"].shape == (2, 1)


def test_those_that_end_begin_anew_when_they_are_told_to(kind: Environments) -> None:
    envs = kind.many(3, autoreset_mode="Disabled")
    envs.reset(seed=1)
    ended = np.zeros(3, bool)
    while not ended.any():
        before, _, terminated, truncated, _ = envs.step(gas(3))
        ended = terminated | truncated
    with pytest.raises(Exception, match="ended; reset them with options reset_mask"):
        envs.step(gas(3))
    after, infos = envs.reset(options={"reset_mask": ended})
    assert infos["_trial"].tolist() == ended.tolist()
    assert [bool(after["speed"][i] == before["speed"][i]) for i in range(3)] == (~ended).tolist()
    envs.step(gas(3))


def test_a_suites_trials_are_driven_one_each(kind: Environments) -> None:
    trials = [trial.id for trial in load_suite("smoke@3").trials if trial.town == "Town01"][:3]
    envs = kind.many(3, suite="smoke@3", trial=trials[0])
    assert envs.reset(options={"trial": trials})[1]["trial"].tolist() == trials
    assert envs.reset()[1]["trial"].tolist() == trials[:1] * 3


class Learned:
    """Refuses as a torch tensor that requires a gradient."""

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise RuntimeError("Can't call numpy() on Tensor that requires grad.")


BAD = gas(2)
BAD[1, 2] = np.nan


def test_actions_that_are_none_are_named_and_nothing_is_driven(kind: Environments) -> None:
    envs, others = kind.many(), kind.many()
    with pytest.raises(Exception, match="reset"):
        envs.step(gas(2))
    envs.reset(seed=1)
    others.reset(seed=1)
    for actions, named in (
        (BAD, r"actions\[1\].brake: is nan"),
        (gas(2) * 3, r"actions\[0\].throttle: is 1.5"),
        (gas(2) * -20, r"actions\[0\].steer: is -2"),
        (GAS, r"actions: give \(2, 3\)"),
        (gas(3), r"actions: give \(2, 3\)"),
        ("left", "actions: give"),
        (None, "actions: give"),
        ([["0", "0.5", "0"]] * 2, "actions: give"),
        (np.zeros((2, 3), complex), "actions: give .*, not complex128"),
        ([[0, 0, 0], [0, 0]], "actions: give"),
        (Learned(), "actions: give"),
    ):
        with pytest.raises(ValueError, match=named):
            envs.step(actions)
    for given in ([Action(0.1, 0.5, 0.0), (0.1, 0.5, 0.0)], [[0.1, 0.5, 0.0]] * 2):
        seen = [envs.step(given)[0], others.step(np.tile([0.1, 0.5, 0.0], (2, 1)))[0]]
        for name, array in seen[0].items():
            assert array.tobytes() == seen[1][name].tobytes()


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"number": 0}, "num_envs"),
        ({"number": True}, "num_envs"),
        ({"number": 2.5}, "num_envs"),
        ({"autoreset_mode": "same"}, "^autoreset_mode: 'same' is unknown; give one of NextStep, SameStep, Disabled"),
        ({"render_mode": "human"}, "render_mode"),
    ],
)
def test_what_cannot_be_made_says_why(kind: Environments, options: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        kind.many(**options)


@pytest.mark.parametrize(
    ("call", "named"),
    [
        ({"seed": [1, 2, 3]}, "seed"),
        ({"options": {"trial": ["a"]}}, "options.trial"),
        ({"options": {"trial": 5}}, "options.trial"),
        ({"options": {"trial": "a"}}, "suite"),
        ({"options": {"reset_mask": [1, 0]}}, "reset_mask"),
        ({"options": {"reset_mask": np.zeros(2, bool)}}, "reset_mask"),
    ],
)
def test_a_reset_that_cannot_be_leaves_the_episodes_as_they_are(
    kind: Environments, call: dict[str, Any], named: str
) -> None:
    envs, others = kind.many(), kind.many()
    envs.reset(seed=1)
    others.reset(seed=1)
    with pytest.raises(ValueError, match=named):
        envs.reset(**call)
    assert envs.step(gas(2))[0]["speed"].tobytes() == others.step(gas(2))[0]["speed"].tobytes()


def test_pictures_are_those_of_single_environments(kind: Environments) -> None:
    envs = kind.many(2, fault="omission", render_mode="rgb_array", autoreset_mode="Disabled")
    with pytest.raises(Exception, match="reset"):
        envs.render()
    singles: list[Any] = [kind.one(fault="omission", render_mode="rgb_array") for _ in range(2)]
    envs.reset(seed=4)
    for i, env in enumerate(singles):
        env.reset(seed=4 + i)
    ended = np.zeros(2, bool)
    for step in range(60):
        if step in {0, 1, 30, 59}:
            for env, picture in zip(singles, envs.render(), strict=True):
                np.testing.assert_array_equal(env.render(), picture)
        _, _, terminated, truncated, _ = envs.step([(0.0, 0.6, 0.0)] * 2)
        ended = terminated | truncated
        for env in singles:
            env.step((0.0, 0.6, 0.0))
        if ended.any():
            break
    assert ended.any()
    pictures = envs.render()
    for env, picture in zip(singles, pictures, strict=True):
        np.testing.assert_array_equal(env.render(), picture)
    assert not np.array_equal(*pictures)


# Of the batch in process only: it is fast, so it is compared with the single environment in many more ways.


@pytest.mark.parametrize("track", ["state", "privileged"])
@pytest.mark.parametrize("fault", ["none", "infeasible", "omission"])
@pytest.mark.parametrize("town", ["junctions", "Town01"])
def test_random_drives(in_process: Environments, town: str, fault: str, track: str) -> None:
    verdicts = compare(in_process, drawn_actions(12, 150), town=town, fault=fault, track=track, threads=3)
    assert len(verdicts) > 12
    assert len(set(verdicts)) > 2


@pytest.mark.parametrize("track", ["camera", "segmentation"])
def test_random_drives_with_pictures(in_process: Environments, track: str) -> None:
    options = {"town": "Town01", "track": track, "weather": ["HardRainNoon", "ClearSunset", "ClearNoon"]}
    assert compare(in_process, drawn_actions(5, 60), threads=2, **options)


def test_trials_of_a_suite(in_process: Environments) -> None:
    assert compare(in_process, drawn_actions(6, 80), suite="smoke@3", track="state")


def test_a_fault_that_is_not_compiled(in_process: Environments, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wrongturn_sim.fleet.fleet._COMPILED", {})
    for fault in ("none", "infeasible", "omission"):
        compare(in_process, drawn_actions(6, 60), fault=fault, track="privileged")


@pytest.mark.parametrize("track", ["state", "privileged"])
@pytest.mark.parametrize("town", ["Town01", "Town02"])
def test_cruises(in_process: Environments, town: str, track: str) -> None:
    options = {"town": town, "task": "cruise", "track": track, "journeys": {"time_limit": 6.0}}
    options["weather"] = ["ClearNoon", "HardRainNoon"]
    strict = compare(in_process, drawn_actions(8, 150), strict=True, threads=2, **options)
    assert {"off_road", "not_engaged", "timeout"} <= set(strict)
    lax = compare(in_process, drawn_actions(8, 150), AutoresetMode.SAME_STEP, **options)
    assert set(lax) <= {"collision", "timeout"}


@pytest.mark.parametrize("starts", [{"near_junctions": 1.0}, {"near_junctions": 0.0, "inside_junctions": 1.0}])
def test_cruises_that_start_near_and_inside_junctions(in_process: Environments, starts: dict[str, float]) -> None:
    journeys = {"time_limit": 6.0, "near_bends": 0.0, **starts}
    options = {"town": "Town01", "task": "cruise", "track": "privileged", "journeys": journeys}
    compare(in_process, drawn_actions(8, 150), strict=True, threads=2, **options)
