"""Compare model files on held-out journeys beyond the 50 that a training run drives by default.

    python -m lab.held_out one.onnx other.onnx --journeys 200 --json driven.json

A run keeps the best of its agents by 50 journeys alone and the same 50 beside simple traffic. These journeys have the
next seeds, in the same towns, with the same traffic and under the same rules: a drive also fails when the car leaves
its road or lane, or stands. On a CPU a drive by a ResNet-34 takes 11 to 25 seconds of a core. After every 50 journeys
the command says how many are done, and writes what all agents did so far into the file of ``--json``.

With ``--cameras`` each five of the journeys have a camera of their own, up to 2.9 degrees of tilt, 0.2 m of height and
8 % of focal length away from the benchmark's, as in a training with ``cameras=true``. Here the tilt is a horizon that
is moved up or down. The command then writes after every five.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import torch
from torch import Tensor

from lab.studies import threads
from wrongturn_agents.errors import AgentsError
from wrongturn_agents.onnx_agent import OnnxAgent, open_session
from wrongturn_agents.training.drive import drive_trials
from wrongturn_agents.training.held_out import held_out_journeys, with_traffic
from wrongturn_agents.training.methods.ppo.config import PPOConfig
from wrongturn_agents.training.world import MEETING, held_out_towns, mounts_of
from wrongturn_protocol import Track
from wrongturn_protocol.json_output import JsonFileError, check_json_file, write_json

_RUN: Final = PPOConfig(towns=1)
"""A run's number of journeys and its rules. With drawn towns, whatever their number, it has two held-out ones."""
_AT_ONCE: Final = 50
"""Journeys between two writes of the file, without ``--cameras``. A portion waits for its longest: few are faster."""
_WITH_ONE_CAMERA: Final = 5
"""Journeys that share a camera with ``--cameras``."""
_CAMERAS: Final = 2**40
"""Number of the stream of these cameras' seeds, which no training has."""
_TRACKS: Final = (Track.CAMERA, Track.SEGMENTATION)


class BatchedFile:
    """A model of pictures without a memory, as a network that drives many cars at once."""

    def __init__(self, file: Path, threads: int) -> None:
        """Load a file. Raises :class:`AgentsError` if it is no such model."""
        agent = OnnxAgent(file)
        if agent.track not in _TRACKS or not agent.memoryless or agent.rig is not None:
            raise AgentsError(
                f"{file}: has a memory, a rig or another track than camera or segmentation; give one without"
            )
        self.track = agent.track
        self._session = open_session(file, threads)
        self._names = [one.name for one in self._session.get_inputs()]

    def drive(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return steer, throttle and brake, (b, 3)."""
        (action,) = self._session.run(["action"], {name: observation[name].cpu().numpy() for name in self._names})
        return torch.from_numpy(action)


def main(argv: Sequence[str] | None = None) -> None:
    """Drive the journeys and print a line for each file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("files", nargs="+", type=Path, help="Model files. Example: ppo-image.onnx")
    parser.add_argument("--journeys", type=int, default=200, help="Number of journeys. Example: --journeys 200")
    parser.add_argument("--after", type=int, default=0, help="Leave out so many first. Example: --after 100")
    parser.add_argument("--cameras", action="store_true", help="Give each five another camera. Example: --cameras")
    parser.add_argument("--device", default="cpu", help="Device of the pictures. Example: --device cuda")
    parser.add_argument("--threads", type=int, default=threads(), help="Threads. Example: --threads 8")
    parser.add_argument("--json", type=Path, help="File for what each agent did. Example: --json driven.json")
    args = parser.parse_args(argv)
    for name, least in (("journeys", 1), ("threads", 1), ("after", 0)):
        if getattr(args, name) < least:
            parser.error(f"--{name}: is {getattr(args, name)}; give {least} or more")
    if args.cameras and args.after % _WITH_ONE_CAMERA:
        parser.error(f"--after: is {args.after}; give a multiple of {_WITH_ONE_CAMERA}, because so many share a camera")
    try:
        check_json_file(args.json)
        models = {str(file): BatchedFile(file, args.threads) for file in args.files}
    except (AgentsError, JsonFileError) as error:
        parser.error(str(error))
    track, *others = {model.track for model in models.values()}
    if others:
        parser.error("files: are of both tracks; compare those of one")
    towns = held_out_towns(_RUN)
    last = args.after + args.journeys
    journeys = held_out_journeys(_RUN.journeys + last, towns)[_RUN.journeys + args.after :]
    told: dict[str, dict[str, bool]] = {file: {} for file in models}
    portion = _WITH_ONE_CAMERA if args.cameras else _AT_ONCE
    # A moved horizon instead of a pitched camera: a CPU draws it ten times faster.
    mounts = mounts_of(-(-last // portion), _CAMERAS, level=True)[args.after // portion :] if args.cameras else []
    for done in range(0, len(journeys), portion):
        alone = journeys[done : done + portion]
        driven = drive_trials(
            list(models.values()),
            [*alone, *with_traffic(alone)],
            track=track,
            device=args.device,
            threads=args.threads,
            patience=_RUN.patience,
            strict=_RUN.strict_evaluation,
            towns={town.name: town for town in towns},
            own_traffic=MEETING,
            camera=mounts[done // portion] if mounts else None,
        )
        for file, drives in zip(told, driven, strict=True):
            told[file] |= {one.trial.id: one.arrived for one in drives}
        write_json(json.dumps(told, indent=1), args.json)
        print(f"{done + len(alone)} of {len(journeys)} journeys", flush=True)
    for file, arrived in told.items():
        by_itself, in_traffic = (sum(arrived[one.id] for one in some) for some in (journeys, with_traffic(journeys)))
        through = ", through other cameras" if args.cameras else ""
        print(f"{file}: {by_itself} alone, {in_traffic} beside traffic, of {len(journeys)} each{through}")


if __name__ == "__main__":
    main()
