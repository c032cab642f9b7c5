"""Drive given trials with trained agents, many at once, in this process."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from torch import Tensor

from wrongturn_networks import Town, load_town
from wrongturn_protocol import Outcome, Track, Trial, Verdict
from wrongturn_sim import FleetTraffic, WrongturnVectorEnv

SLOW = 0.3
"""A slower car counts as standing, m/s."""
_PER_SECOND = 10
"""Decisions in a second."""
_ROWS = 64
"""On CUDA a network gets a multiple of this many pictures, or all of them."""


class DrivingModel(Protocol):
    """A network that drives, such as an agent of ``wrongturn_agents.models``."""

    def drive(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return steer, throttle and brake, (b, 3)."""


@runtime_checkable
class RememberingModel(Protocol):
    """A network that drives and remembers things within a drive."""

    def begin(self, count: int) -> Tensor:
        """Return the memory of cars that begin their drives, (count, ...)."""

    def drive_on(self, observation: Mapping[str, Tensor], memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return steer, throttle and brake, (b, 3), and the new memory."""


AnyModel = DrivingModel | RememberingModel


def begin(model: AnyModel, count: int) -> Tensor:
    """Return the memory of cars that begin their drives, (count, ...); of width 0 if the network has none."""
    return model.begin(count) if isinstance(model, RememberingModel) else torch.zeros(count, 0)


def drive_on(model: AnyModel, observation: Mapping[str, Tensor], memory: Tensor) -> tuple[Tensor, Tensor]:
    """Return steer, throttle and brake, (b, 3), and the new memory."""
    if isinstance(model, RememberingModel):
        return model.drive_on(observation, memory)
    return model.drive(observation), memory


def is_driver(model: object) -> bool:
    """Return whether a network drives by itself."""
    return isinstance(model, RememberingModel) or hasattr(model, "drive")


class DrivenTrial(NamedTuple):
    """A trial and how it ended."""

    trial: Trial
    outcome: Outcome | None
    """None if the drive was given up."""
    reward: float
    """Sum of the paper's reward."""
    stopped: bool = False
    """Whether ``stop`` ended the drive, or kept it from beginning."""

    @property
    def arrived(self) -> bool:
        """Whether a journey reached its goal in time."""
        return self.outcome is not None and self.outcome.verdict is Verdict.ARRIVED


def drive_trials(
    models: Sequence[AnyModel],
    trials: Sequence[Trial],
    *,
    track: Track | str,
    device: torch.device | str = "cpu",
    threads: int = 1,
    batch: int | None = None,
    patience: float | None = None,
    strict: bool = False,
    towns: Mapping[str, Town] = MappingProxyType({}),
    own_traffic: FleetTraffic = FleetTraffic(),  # noqa: B008 - immutable
    camera: Any = None,
    stop: Callable[[], bool] = lambda: False,
) -> list[list[DrivenTrial]]:
    """Drive every trial with every model, all side by side.

    Several models together take little longer than one, because the longest drive decides how long it takes.

    Args:
        models: networks that drive with their mean actions, in float32. One that remembers gets its memory back.
        trials: trials in any towns. Those with other road users drive beside the batch's own traffic, not SUMO's.
        track: track whose observations the models get.
        device: device of the models and of the pictures.
        threads: threads that share the simulation.
        batch: number of cars at once; by default 16 on the CPU and 256 on CUDA.
        patience: a drive is given up after its car stood still for this long without being blocked,
            seconds. None never gives up.
        strict: as in training, a journey fails when the car leaves its road or lane, or stands for 10 s. Scores never
            use it.
        towns: the towns of the trials that are not installed, by name.
        own_traffic: how other road users behave.
        camera: a ``wrongturn_sim.camera.Camera`` for all cars, in the tracks that have one; the benchmark's by default.
        stop: called before each decision; True gives up all drives that have not ended.

    Returns:
        One list for each model: its drives in the order of the trials.
    """
    device = torch.device(device)
    options = {
        "track": Track(track),
        "own_traffic": own_traffic,
        "camera": camera,
        "threads": threads,
        "strict": strict,
        **({"backend": "cuda"} if device.type == "cuda" else {}),
    }
    width = batch or (256 if device.type == "cuda" else 16)
    assigned = [(model, trial) for model in models for trial in trials]
    found: dict[int, DrivenTrial] = {}
    by_town: dict[tuple[str, int | None], list[int]] = {}
    for i, (_, trial) in enumerate(assigned):
        by_town.setdefault((trial.town, trial.scenery), []).append(i)
    for (name, scenery), numbers in by_town.items():
        town = towns.get(name) or load_town(name, scenery)
        found |= _in_town(town, numbers, assigned, device, width, patience, stop, options)
    count = len(trials)
    return [[found[i * count + k] for k in range(count)] for i in range(len(models))]


def _in_town(
    town: Town,
    numbers: list[int],
    assigned: Sequence[tuple[AnyModel, Trial]],
    device: torch.device,
    width: int,
    patience: float | None,
    stop: Callable[[], bool],
    options: dict[str, Any],
) -> Iterator[tuple[int, DrivenTrial]]:
    count = min(width, len(numbers))
    envs = WrongturnVectorEnv(count, town, **options, record=False, copy=False, autoreset_mode=AutoresetMode.DISABLED)
    # The longest trials come first, so that fewer cars wait for the last ones.
    waiting = sorted(numbers, key=lambda i: -_time_limit(assigned[i][1]))
    driving: list[int | None] = [waiting.pop(0) for _ in range(count)]
    current = [assigned[i] for i in driving if i is not None]
    rewards, stood = np.zeros(count), np.zeros(count, np.int64)
    memories = {model: begin(model, count) for model, _ in assigned}
    observation, _ = envs.reset(seed=0, options={"trial": [trial for _, trial in current]})
    try:
        while any(number is not None for number in driving):
            models = [None if number is None else assigned[number][0] for number in driving]
            actions = _actions(models, observation, memories, device)
            observation, earned, terminated, truncated, infos = envs.step(actions)
            ended = terminated | truncated
            rewards += earned
            stands = (np.asarray(observation["speed"])[:, 0] < SLOW) & ~envs.waits
            stood = np.where(stands, stood + 1, 0)
            if stop():
                left = [number for number in (*driving, *waiting) if number is not None]
                yield from ((number, DrivenTrial(assigned[number][1], None, 0.0, True)) for number in left)
                return
            given_up = np.zeros(count, np.bool_) if patience is None else stood >= patience * _PER_SECOND
            restarted = np.zeros(count, np.bool_)
            for k in np.flatnonzero(ended | given_up).tolist():
                number = driving[k]
                if number is not None:
                    outcome = Outcome.model_validate(infos["outcome"][k]) if ended[k] else None
                    yield number, DrivenTrial(assigned[number][1], outcome, float(rewards[k]))
                    driving[k] = waiting.pop(0) if waiting else None
                # All cars step together. A car without a trial repeats its last one, which does not count.
                following = driving[k]
                if ended[k] or following is not None:
                    current[k] = current[k] if following is None else assigned[following]
                    restarted[k], rewards[k], stood[k] = True, 0.0, 0
            if restarted.any() and any(number is not None for number in driving):
                trials = [trial for _, trial in current]
                observation, _ = envs.reset(options={"trial": trials, "reset_mask": restarted})
                for model, memory in memories.items():
                    cars = torch.as_tensor(np.flatnonzero(restarted), device=memory.device)
                    memory[cars] = begin(model, len(cars))
    finally:
        envs.close()


@torch.inference_mode()
def _actions(
    models: list[AnyModel | None], observation: dict[str, Any], memories: dict[AnyModel, Tensor], device: torch.device
) -> NDArray[np.float32]:
    """Return each car's action from its own model; a car without a model brakes."""
    tensors = {name: torch.as_tensor(array, device=device) for name, array in observation.items()}
    actions = np.tile(np.array([0.0, 0.0, 1.0], np.float32), (len(models), 1))
    for model in dict.fromkeys(models):
        if model is None:
            continue
        rows = [i for i, other in enumerate(models) if other is model]
        own, chosen = tensors, torch.as_tensor(rows, device=device)
        if len(rows) < len(models):
            # Few sizes only, because cuDNN selects its algorithms again for each size.
            more = -len(rows) % _ROWS if device.type == "cuda" else 0
            chosen = torch.as_tensor(rows + rows[:1] * more, device=device)
            own = {name: tensor[chosen] for name, tensor in tensors.items()}
        memory = memories[model]
        cars = chosen.to(memory.device)
        action, memory[cars] = drive_on(model, own, memory[cars])
        actions[rows] = action[: len(rows)].float().cpu().numpy()
    return actions


def _time_limit(trial: Trial) -> float:
    return trial.journey.time_limit if trial.journey else 0.0
