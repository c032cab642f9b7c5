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
_ROWS = 64
"""What a network is given on CUDA is a multiple of this many pictures, or all."""


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


def drive_all(model: Driver, trials: Sequence[Trial], **options: Any) -> list[Drive]:
    """What each trial came to, in their order; the options are :func:`drive_each`'s."""
    return drive_each([model], trials, **options)[0]


def drive_each(
    models: Sequence[Driver],
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
) -> list[list[Drive]]:
    """Drive trials of one or more towns, none with other road users, by each of some models, all side by side.

    Several together take little longer than one: it is the longest drive that is waited for.

    Args:
        models: drive by their mean actions, in float32.
        trials: any.
        track: what they are shown.
        device: where they compute.
        backend: where pictures are made; on the device's kind by default.
        threads: share the simulation.
        batch: how many are driven side by side; 16 on the CPU, else 256.
        patience: give a drive up whose car stood still for so many seconds running; None never does.
        strict: a journey fails where the car leaves its road or lane, or stands for 10 s, as in training; what is
            scored never is.
        stop: give up all that is not over yet.
        on_end: told of each drive when it is over.

    Returns:
        For each model its drives, in the order of the trials.
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
    wanted = [_Wanted(model, trial) for model in models for trial in trials]
    found: list[Drive | None] = [None] * len(wanted)
    by_town = sorted(range(len(wanted)), key=lambda i: wanted[i].trial.town)
    for town, numbers in groupby(by_town, key=lambda i: wanted[i].trial.town):
        for i, driven in _in_town(town, list(numbers), wanted, device, width, patience, stop, options):
            found[i] = driven
            on_end(driven)
    driven_all = [driven for driven in found if driven is not None]
    return [driven_all[i * len(trials) : (i + 1) * len(trials)] for i in range(len(models))]


class _Wanted(NamedTuple):
    """A drive to be driven."""

    model: Driver
    trial: Trial


def _in_town(
    town: str,
    numbers: list[int],
    wanted: Sequence[_Wanted],
    device: torch.device,
    width: int,
    patience: float | None,
    stop: Callable[[], bool],
    options: dict[str, Any],
) -> Iterator[tuple[int, Drive]]:
    count = min(width, len(numbers))
    envs = WrongturnVectorEnv(count, town, **options, record=False, copy=False, autoreset_mode=AutoresetMode.DISABLED)
    # The longest first: so fewer egos idle while the last ones finish.
    waiting = sorted(numbers, key=lambda i: -_time_limit(wanted[i].trial))
    driving: list[int | None] = [waiting.pop(0) for _ in range(count)]
    current = [wanted[i] for i in driving if i is not None]
    rewards, stood = np.zeros(count), np.zeros(count, np.int64)
    observation, _ = envs.reset(seed=0, options={"trial": [one.trial for one in current]})
    try:
        while any(number is not None for number in driving):
            who = [None if number is None else wanted[number].model for number in driving]
            actions = _actions(who, observation, device)
            observation, earned, terminated, truncated, infos = envs.step(actions)
            ended = terminated | truncated
            rewards += earned
            stood = np.where(np.asarray(observation["speed"])[:, 0] < _STANDING, stood + 1, 0)
            if stop():
                left = [number for number in (*driving, *waiting) if number is not None]
                yield from ((number, Drive(wanted[number].trial, None, 0.0)) for number in left)
                return
            given_up = np.zeros(count, np.bool_) if patience is None else stood >= patience * _PER_SECOND
            anew = np.zeros(count, np.bool_)
            for k in np.flatnonzero(ended | given_up).tolist():
                number = driving[k]
                if number is not None:
                    outcome = Outcome.model_validate(infos["outcome"][k]) if ended[k] else None
                    yield number, Drive(wanted[number].trial, outcome, float(rewards[k]))
                    driving[k] = waiting.pop(0) if waiting else None
                # One that has nothing left to drive drives its last trial again, to no avail: egos share their steps.
                following = driving[k]
                if ended[k] or following is not None:
                    current[k] = current[k] if following is None else wanted[following]
                    anew[k], rewards[k], stood[k] = True, 0.0, 0
            if anew.any() and any(number is not None for number in driving):
                trials = [one.trial for one in current]
                observation, _ = envs.reset(options={"trial": trials, "reset_mask": anew})
    finally:
        envs.close()


@torch.inference_mode()
def _actions(models: list[Driver | None], observation: dict[str, Any], device: torch.device) -> np.ndarray[Any, Any]:
    """Of each car by its own model; those that nobody drives any more brake."""
    tensors = {name: torch.as_tensor(array, device=device) for name, array in observation.items()}
    actions = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(models), 1))
    for model in dict.fromkeys(models):
        if model is None:
            continue
        rows = [i for i, other in enumerate(models) if other is model]
        its = tensors
        if len(rows) < len(models):
            # In few sizes, for cuDNN chooses its algorithms anew for each.
            more = -len(rows) % _ROWS if device.type == "cuda" else 0
            chosen = torch.as_tensor(rows + rows[:1] * more, device=device)
            its = {name: tensor[chosen] for name, tensor in tensors.items()}
        actions[rows] = model.drive(its)[: len(rows)].float().cpu().numpy()
    return actions


def _time_limit(trial: Trial) -> float:
    return trial.journey.time_limit if trial.journey else 0.0
