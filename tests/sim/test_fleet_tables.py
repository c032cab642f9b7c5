"""A batch's tables of places survive an interruption."""

from typing import Any

import pytest
from gymnasium.vector import AutoresetMode

from wrongturn_judge import JudgeGeometry
from wrongturn_networks import load_suite
from wrongturn_protocol import Outcome, Trial
from wrongturn_sim import WrongturnVectorEnv


def driven(envs: WrongturnVectorEnv, trial: Trial) -> Outcome | None:
    """Drive a trial straight on, and return its outcome."""
    envs.reset(seed=0, options={"trial": [trial]})
    over = False
    while not over:
        _, _, terminated, truncated, _ = envs.step([(0.0, 0.5, 0.0)])
        over = bool(terminated[0] or truncated[0])
    record = envs.episode(0)
    assert record is not None
    return record.outcome


def test_a_trial_whose_beginning_was_interrupted_is_judged_as_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = load_suite("wrong-command@2").episodes[0], load_suite("wrong-command@2").episodes[-1]
    assert first.approach != second.approach

    def made() -> WrongturnVectorEnv:
        return WrongturnVectorEnv(1, "Town01", "privileged", autoreset_mode=AutoresetMode.DISABLED)

    envs = made()
    expected = [driven(envs, first), driven(envs, second)]
    envs.close()
    envs = made()

    def interrupted(*_: Any) -> JudgeGeometry:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(JudgeGeometry, "of", interrupted)
        with pytest.raises(KeyboardInterrupt):
            envs.reset(seed=0, options={"trial": [first]})
    assert [driven(envs, second), driven(envs, first)] == expected[::-1]
    envs.close()
