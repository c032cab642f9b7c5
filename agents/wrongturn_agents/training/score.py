"""Drive a whole suite with a checkpoint in this process, without a service."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from wrongturn_agents.agent import Agent
from wrongturn_agents.registry import AgentSource, resolve
from wrongturn_agents.results_file import ResultsFile, TrialResult
from wrongturn_agents.stored_results import shipped_seeds
from wrongturn_agents.training.devices import device_of
from wrongturn_agents.training.drive import AnyModel, drive_trials, is_driver
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.method import load
from wrongturn_client.episode_calls import action_of
from wrongturn_networks import Suite, load_suite
from wrongturn_protocol import Track, Traffic, Trial
from wrongturn_protocol.observations import observation_space

Results = dict[str, Any]
"""Fields of a :class:`~wrongturn_agents.results_file.ResultsFile`."""
_AGENTS = 24
"""Registered agents side by side. More of them share each step's cost, but wait longer for the last one."""


def score(
    checkpoint: Path | str,
    suite: str,
    *,
    device: str = "auto",
    threads: int | None = None,
    batch: int | None = None,
    traffic: bool = False,
) -> Results:
    """Drive each trial and twin of a suite with the mean action, in float32.

    Trials with other road users need SUMO and are left out. With ``traffic``, only they are driven, beside a batch's
    own simple traffic: an estimate of what they would give in SUMO.

    Args:
        checkpoint: a run's ``best.pt``, ``last.pt`` or ``privileged.pt``.
        suite: id of the suite. Example: ``wrong-command@3``. Of a suite that draws its trials, the
            open draw is driven.
        device: ``cpu``, ``cuda`` or ``auto``.
        threads: threads that share the simulation; all cores by default.
        batch: number of trials at once; by default 16 on the CPU and 256 on CUDA.
        traffic: drive the trials with other road users instead of the others.

    Raises:
        TrainingError: the file is no checkpoint, or the device is not there.
        UnknownSuiteError: there is no such suite.
    """
    for name, value in (("threads", threads), ("batch", batch)):
        if value is not None and value < 1:
            raise TrainingError(f"{name}: is {value}; give 1 or more")
    place = device_of(device)
    loaded = load(checkpoint, place)
    if not is_driver(loaded.model):
        raise TrainingError(
            f"checkpoint {checkpoint}: {loaded.agent.name} does not drive by itself; export it, and name the .onnx file"
        )
    # Everything in float32, as in the exported file.
    with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
        return _score(
            loaded.model,
            load_suite(suite),
            loaded.agent.track,
            traffic=traffic,
            options={"device": place, "threads": threads or _cores(), "batch": batch},
            agent=loaded.agent.name,
            seed=loaded.told["seed"],
            variant=loaded.variant,
            steps=loaded.told["steps"],
            device=torch.cuda.get_device_name() if place.type == "cuda" else "cpu",
        )


def score_agent(name: str, suite: str, *, threads: int | None = None, traffic: bool = False) -> Results:
    """Drive each trial and twin of a suite with a registered agent, as it is shipped; see :func:`score`.

    Raises:
        AgentsError: there is no such agent, or it fails.
        UnknownSuiteError: there is no such suite.
    """
    source, threads = resolve(name), threads or _cores()
    if source.rig is not None or source.track is Track.WORDS:
        raise TrainingError(f"agent: {name} sees more than a batch of cars shows; drive it by wrongturn run --workers")
    with ThreadPoolExecutor(threads) as pool:
        return _score(
            _Agents(source, pool),
            load_suite(suite),
            source.track,
            traffic=traffic,
            options={"threads": threads, "batch": _AGENTS},
            agent=source.name,
            seed=shipped_seeds().get(source.name),
            device="cpu",
        )


class _Agents:
    """Agents that drive side by side as one network: each car's memory is the number of its own agent."""

    def __init__(self, source: AgentSource, pool: ThreadPoolExecutor) -> None:
        self._source, self._pool = source, pool
        self._space = observation_space(source.track)
        self._driving: dict[int, Agent] = {}
        self._begun = 0

    def begin(self, count: int) -> Tensor:
        """Return the numbers of new agents, (count, 1)."""
        self._begun += count
        return torch.arange(self._begun - count, self._begun).unsqueeze(1)

    def drive_on(self, observation: Mapping[str, Tensor], memory: Tensor) -> tuple[Tensor, Tensor]:
        """Return each agent's steer, throttle and brake, (b, 3). Who drives no more begins anew for a new number."""
        numbers = memory[:, 0].tolist()
        free = [self._driving.pop(number) for number in [*self._driving] if number not in numbers]
        for number in numbers:
            if number not in self._driving:
                self._driving[number] = agent = free.pop() if free else self._source.make()
                agent.reset(self._space)

        def act(k: int) -> tuple[float, float, float]:
            seen = {name: tensor[k].numpy().copy() for name, tensor in observation.items()}
            action = action_of(self._driving[numbers[k]].act(seen))
            return action.steer, action.throttle, action.brake

        shared = getattr(self._driving[numbers[0]], "memoryless", False)
        cars = range(len(numbers))
        return torch.tensor(list(self._pool.map(act, cars) if shared else map(act, cars))), memory


def _cores() -> int:
    return len(os.sched_getaffinity(0))


def _score(
    model: AnyModel, suite: Suite, track: Track, *, traffic: bool, options: dict[str, Any], **facts: Any
) -> Results:
    (driven,) = drive_trials([model], _trials_of(suite, traffic=traffic), track=track, **options)
    return ResultsFile(
        suite=suite.id,
        suite_sha256=suite.sha256,
        secret=suite.open_draw.secret,
        driven="in process",
        trials={one.trial.id: TrialResult.of(one.outcome) for one in driven if one.outcome is not None},
        **facts,
    ).model_dump(mode="json")


def _trials_of(suite: Suite, *, traffic: bool) -> list[Trial]:
    """Return the trials of a suite with other road users, or those without."""
    trials = [trial for trial in suite.episodes if (trial.traffic != Traffic()) == traffic]
    if not trials:
        raise TrainingError(
            f"suite: {suite.id} has no trials {'with' if traffic else 'without'} other road users; "
            f"{'leave --traffic out' if traffic else 'score it with --traffic'}"
        )
    return trials


def summary(results: Results) -> Iterator[str]:
    """Return one line for each town and kind of trial, with its verdicts."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for trial, found in results["trials"].items():
        town, _, rest = trial.partition(".")
        kind = next((part for part in rest.split(".") if part.islower()), rest)
        counts.setdefault((town, kind), Counter())[found["verdict"]] += 1
    for (town, kind), verdicts in sorted(counts.items()):
        text = ", ".join(f"{verdict} {count}" for verdict, count in verdicts.most_common())
        yield f"{town} {kind}: {text}"
