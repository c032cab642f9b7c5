"""Drive given trials by an agent's mean action, many side by side in this process."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import Tensor

from wrongturn_protocol import Outcome, Track, Trial
from wrongturn_sim import WrongturnVectorEnv

_STANDING = 0.3
"""Slower than this a car stands, m/s."""
_PER_SECOND = 10
"""Decisions."""


class Driver(Protocol):
    """What drives: an agent of ``wrongturn_agents.models``."""

    def drive(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Steer, throttle and brake, (b, 3)."""


class Drive(NamedTuple):
    """A trial that was driven."""

    trial: Trial
    outcome: Outcome | None
    """None where the drive was given up."""
    reward: float
    """The sum of the paper's reward."""


def drive(model: Driver, trials: Sequence[Trial], **options: Any) -> list[tuple[Trial, Outcome]]:
    """What each trial came to, in their order; the options are :func:`drive_all`'s."""
    driven = drive_all(model, trials, **options)
    return [(one.trial, one.outcome) for one in driven if one.outcome is not None]


def drive_all(
    model: Driver,
    trials: Sequence[Trial],
    *,
    track: Track | str,
    device: torch.device | str = "cpu",
    backend: Literal["cpu", "cuda"] | None = None,
    threads: int = 1,
    batch: int | None = None,
    patience: float | None = None,
    strict: bool = False,
    stop: Callable[[], bool] = lambda: False,
    on_end: Callable[[Drive], None] = lambda _: None,
) -> list[Drive]:
    """Drive trials of one or more towns, none with other road users.

    Args:
        model: drives by its mean action, in float32.
        trials: any.
        track: what it is shown.
        device: where it computes.
        backend: where pictures are made; on the device's kind by default.
        threads: share the simulation.
        batch: how many are driven side by side; 16 on the CPU, else 256.
        patience: give a drive up whose car stood still for so many seconds running; None never does.
        strict: a journey fails where the car leaves its road or lane, or stands for 10 s, as in training; what is
            scored never is.
        stop: give up all that is not over yet.
        on_end: told of each drive when it is over.

    Returns:
        In the order of the trials.
    """
    device = torch.device(device)
    kind = device.type
    options = {
        "track": Track(track),
        "threads": threads,
        "strict": strict,
        **({"backend": "cuda"} if (backend or kind) == "cuda" else {}),
    }
    width = batch or (256 if kind == "cuda" else 16)
    found: list[Drive | None] = [None] * len(trials)
    by_town = sorted(range(len(trials)), key=lambda i: trials[i].town)
    for town, numbers in groupby(by_town, key=lambda i: trials[i].town):
        for i, driven in _in_town(model, town, list(numbers), trials, device, width, patience, stop, options):
            found[i] = driven
            on_end(driven)
    return [driven for driven in found if driven is not None]


def _in_town(
    model: Driver,
    town: str,
    numbers: list[int],
    trials: Sequence[Trial],
    device: torch.device,
    width: int,
    patience: float | None,
    stop: Callable[[], bool],
    options: dict[str, Any],
) -> Iterator[tuple[int, Drive]]:
    count = min(width, len(numbers))
    envs = WrongturnVectorEnv(count, town, **options, record=False, copy=False, autoreset_mode=AutoresetMode.DISABLED)
    # The longest first: so fewer egos idle while the last ones finish.
    waiting = sorted(numbers, key=lambda i: -_time_limit(trials[i]))
    driving: list[int | None] = [waiting.pop(0) for _ in range(count)]
    current = [trials[i] for i in driving if i is not None]
    rewards, stood = np.zeros(count), np.zeros(count, np.int64)
    observation, _ = envs.reset(seed=0, options={"trial": list(current)})
    try:
        while any(number is not None for number in driving):
            observation, earned, terminated, truncated, infos = envs.step(_actions(model, observation, device))
            ended = terminated | truncated
            rewards += earned
            stood = np.where(np.asarray(observation["speed"])[:, 0] < _STANDING, stood + 1, 0)
            if stop():
                left = [number for number in (*driving, *waiting) if number is not None]
                yield from ((number, Drive(trials[number], None, 0.0)) for number in left)
                return
            given_up = np.zeros(count, np.bool_) if patience is None else stood >= patience * _PER_SECOND
            anew = np.zeros(count, np.bool_)
            for k in np.flatnonzero(ended | given_up).tolist():
                number = driving[k]
                if number is not None:
                    outcome = Outcome.model_validate(infos["outcome"][k]) if ended[k] else None
                    yield number, Drive(trials[number], outcome, float(rewards[k]))
                    driving[k] = waiting.pop(0) if waiting else None
                # One that has nothing left to drive drives its last trial again, to no avail: egos share their steps.
                following = driving[k]
                if ended[k] or following is not None:
                    current[k] = current[k] if following is None else trials[following]
                    anew[k], rewards[k], stood[k] = True, 0.0, 0
            if anew.any() and any(number is not None for number in driving):
                observation, _ = envs.reset(options={"trial": list(current), "reset_mask": anew})
    finally:
        envs.close()


@torch.inference_mode()
def _actions(model: Driver, observation: dict[str, Any], device: torch.device) -> np.ndarray[Any, Any]:
    tensors = {name: torch.as_tensor(array, device=device) for name, array in observation.items()}
    return model.drive(tensors).float().cpu().numpy()


def _time_limit(trial: Trial) -> float:
    return trial.journey.time_limit if trial.journey else 0.0
