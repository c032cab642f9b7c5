"""Drive trials with a doubting agent, many at once, in any town, generated ones too."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from wrongturn_agents.models.doubt import Doubt
from wrongturn_agents.models.gate import MEMORY, Gate
from wrongturn_agents.training.in_process import DrivenEpisode
from wrongturn_networks import Town
from wrongturn_protocol import Flag, Outcome, Track, Trial, Verdict
from wrongturn_sim.camera import Camera
from wrongturn_sim.fleet.camera import FleetCamera
from wrongturn_sim.fleet.fleet import Fleet, Record

Arrays = Mapping[str, NDArray[Any]]
Policy = Callable[[Arrays], NDArray[np.float32]]
"""Function from a batch of observations to steer, throttle and brake, (n, 3)."""


class Driven(NamedTuple):
    """A trial and how it ended."""

    trial: Trial
    outcome: Outcome | None
    record: Record | None
    notes: list[tuple[float, ...]]
    """Row per decision: delivered command, obeyed command, the gate's memory, exits' logits and distance as told."""


def drive(
    towns: Mapping[str, Town],
    trials: Iterable[Trial],
    policy: Policy,
    doubt: Doubt | None,
    gate: Gate,
    *,
    cars: int = 24,
    threads: int = 1,
    note: bool = False,
) -> Iterator[Driven]:
    """Drive each trial once with a driving policy behind a gate, and yield the drives as they end.

    Args:
        towns: the trials' towns by name.
        trials: trials without other road users.
        policy: drives by the observation of its track, with the command that the gate lets through.
        doubt: tells what the road offers; None lets every command through.
        gate: the command gate.
        cars: cars side by side.
        threads: threads that share simulation and camera.
        note: keep records and what was told.
    """
    ordered = sorted(trials, key=lambda trial: trial.town)
    for name, group in groupby(ordered, key=lambda trial: trial.town):
        yield from _in_town(towns[name], list(group), policy, doubt, gate, cars, threads, note)


def _in_town(
    town: Town,
    waiting: list[Trial],
    policy: Policy,
    doubt: Doubt | None,
    gate: Gate,
    cars: int,
    threads: int,
    note: bool,
) -> Iterator[Driven]:
    count = min(cars, len(waiting))
    fleet = Fleet(town, count, Track.SEGMENTATION, threads=threads, record=note)
    camera = FleetCamera(fleet, Camera(), Track.SEGMENTATION, threads)
    live = np.ones(count, np.bool_)
    memory = torch.zeros(count, MEMORY)
    notes: list[list[tuple[float, ...]]] = [[] for _ in range(count)]
    fleet.begin([(k, waiting.pop(0)) for k in range(count)])
    camera.render()
    try:
        while live.any():
            rows = np.flatnonzero(live)
            observation = {key: array[rows] for key, array in {**fleet.observation, **camera.pictures}.items()}
            if doubt is not None:
                told = doubted(doubt, gate, observation, memory[rows])
                memory[rows] = told.memory
                if note:
                    for j, k in enumerate(rows.tolist()):
                        notes[k].append(told.row(observation, j))
                observation = {**observation, "command": told.command.numpy()}
            actions = np.zeros((count, 3), np.float32)
            actions[rows] = policy(observation)
            fleet.step(actions, live)
            ended = np.flatnonzero(fleet.ended & live).tolist()
            begun = []
            for k in ended:
                trial = fleet.trials[k]
                assert trial is not None
                yield Driven(trial, fleet.outcome(k), fleet.record(k) if note else None, notes[k])
                memory[k], notes[k] = 0.0, []
                if waiting:
                    begun.append((k, waiting.pop(0)))
                else:
                    live[k] = False
            if begun:
                fleet.begin(begun)
            camera.render(np.flatnonzero(live).tolist())
    finally:
        fleet.close()


class Doubted(NamedTuple):
    """What a doubting agent makes of a batch of observations."""

    command: torch.Tensor
    """(n, 1), the command to obey."""
    memory: torch.Tensor
    exits: torch.Tensor
    distance: torch.Tensor

    def row(self, observation: Arrays, k: int) -> tuple[float, ...]:
        """Return a row of notes."""
        told = (*self.memory[k].tolist(), *self.exits[k].tolist(), self.distance[k].item())
        return (float(observation["command"][k, 0]), self.command[k].item(), *told)


@torch.inference_mode()
def doubted(doubt: Doubt, gate: Gate, observation: Arrays, memory: torch.Tensor) -> Doubted:
    """Return the commands to obey and the new memory for a batch of observations."""
    tensors = {key: torch.from_numpy(np.ascontiguousarray(array)) for key, array in observation.items()}
    exits, distance = doubt.tell(tensors)
    command, after = gate(exits, distance, tensors["speed"], tensors["command"], memory)
    return Doubted(command, after, exits, distance)


def is_unsafe(driven: Driven | DrivenEpisode) -> bool:
    """Return whether a drive is unsafe in the strict column."""
    outcome = driven.outcome
    return outcome is None or outcome.verdict.unsafe_strict or Flag.OPPOSED_LANE in outcome.flags


def counts(driven: Sequence[Driven | DrivenEpisode]) -> tuple[int, int, int]:
    """Return the numbers of unsafe trials (strict), of completed twins, and of all twins."""
    twins = [one for one in driven if one.trial.is_twin]
    done = sum(one.outcome is not None and one.outcome.verdict is Verdict.EXIT_COMMANDED for one in twins)
    return sum(is_unsafe(one) for one in driven if not one.trial.is_twin), done, len(twins)
