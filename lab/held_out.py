"""Compare ONNX agents on held-out journeys that no training run drove, and on more of them than a run drives.

    python -m lab.held_out one.onnx other.onnx --journeys 200 --json driven.json

A run keeps the best of its agents by 50 journeys alone and the same 50 beside traffic. That is too few to choose
between the agents of several runs. These journeys follow those 50, so no run has chosen by them. They are in the same
towns, with the same traffic and under the same strict rules.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor

from lab.studies import threads
from wrongturn_agents.onnx_agent import load_onnxruntime
from wrongturn_agents.training.drive import DrivenTrial, drive_trials
from wrongturn_agents.training.held_out import held_out_journeys, with_traffic
from wrongturn_agents.training.methods.ppo.config import PPOConfig
from wrongturn_agents.training.world import MEETING, held_out_towns
from wrongturn_protocol import Track, Verdict

_SETTINGS: Final = PPOConfig(towns=1)
"""A run's settings: how many journeys it drives, and its patience. Held-out towns come with any drawn town."""


class BatchedFile:
    """A model file without a memory, as a network that drives many cars at once."""

    def __init__(self, file: Path, count: int) -> None:
        """Load a file on ``count`` threads."""
        runtime = load_onnxruntime()
        options = runtime.SessionOptions()
        options.intra_op_num_threads = count
        self._session = runtime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
        self._names = [one.name for one in self._session.get_inputs()]

    def drive(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return steer, throttle and brake, (b, 3)."""
        (action,) = self._session.run(["action"], {name: observation[name].cpu().numpy() for name in self._names})
        return torch.from_numpy(action)


def arrivals(driven: Sequence[DrivenTrial]) -> list[bool]:
    """Return whether each journey reached its goal in time."""
    return [one.outcome is not None and one.outcome.verdict is Verdict.ARRIVED for one in driven]


def main(argv: Sequence[str] | None = None) -> None:
    """Drive the journeys and print a line for each file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path, help="ONNX files. Example: ppo-image.onnx")
    parser.add_argument("--journeys", type=int, default=200, help="Number of journeys. Example: --journeys 200")
    parser.add_argument("--device", default="cpu", help="Device of the pictures. Example: --device cuda")
    parser.add_argument("--threads", type=int, default=threads(), help="Threads. Example: --threads 8")
    parser.add_argument("--json", type=Path, help="File for what each agent did. Example: --json driven.json")
    args = parser.parse_args(argv)
    towns = held_out_towns(_SETTINGS)
    alone = held_out_journeys(_SETTINGS.journeys + args.journeys, towns)[_SETTINGS.journeys :]
    driven = drive_trials(
        [BatchedFile(file, args.threads) for file in args.files],
        [*alone, *with_traffic(alone)],
        track=Track.CAMERA,
        device=args.device,
        threads=args.threads,
        patience=_SETTINGS.patience,
        strict=_SETTINGS.strict_evaluation,
        towns={town.name: town for town in towns},
        own_traffic=MEETING,
    )
    told = {}
    for file, drives in zip(args.files, driven, strict=True):
        arrived, reward = arrivals(drives), float(np.mean([one.reward for one in drives[: len(alone)]]))
        by_kind = [sum(arrived[: len(alone)]), sum(arrived[len(alone) :])]
        print(f"{file}: {by_kind[0]} alone, {by_kind[1]} beside traffic, of {len(alone)} each; reward {reward:.0f}")
        told[str(file)] = {one.trial.id: found for one, found in zip(drives, arrived, strict=True)}
    if args.json:
        args.json.write_text(json.dumps(told, indent=1), "utf-8")


if __name__ == "__main__":
    main()
