"""Drive whole suites with a checkpoint in this process: for figures over many seeds, without a service."""

import argparse
import json
import os
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch

from wrongturn_agents.training.checkpoint import load_checkpoint, model_of
from wrongturn_agents.training.config import config_of
from wrongturn_agents.training.drive import drive
from wrongturn_agents.training.errors import TrainingError
from wrongturn_networks import load_suite

Results = dict[str, Any]


def score(
    checkpoint: Path | str,
    suite: str,
    *,
    device: str = "auto",
    threads: int | None = None,
    batch: int | None = None,
) -> Results:
    """What each trial and twin of a suite comes to, driven by the mean action in float32.

    Trials with other road users need SUMO and are left out.

    Returns:
        ``agent``, ``seed``, ``variant``, ``suite``, ``suite_sha256``, ``driven``, ``steps``, ``device`` and
        ``trials``: by id ``verdict``, ``reaction`` and ``clean``.

    Raises:
        TrainingError: the checkpoint is none, or the device cannot be.
        UnknownSuiteError: there is no such suite.
    """
    for name, value in (("threads", threads), ("batch", batch)):
        if value is not None and value < 1:
            raise TrainingError(f"{name}: is {value}; give 1 or more")
    if device not in {"auto", "cpu", "cuda"}:
        raise TrainingError(f"device: is {device!r}; give auto, cpu or cuda")
    found = load_checkpoint(checkpoint)
    config = config_of(found["algorithm"], found["config"])
    place = torch.device("cuda" if device != "cpu" and torch.cuda.is_available() else "cpu")
    if device == "cuda" and place.type != "cuda":
        raise TrainingError("device: torch finds no CUDA device here; give cpu, or install torch for CUDA")
    chosen = load_suite(suite)
    trials = [trial for trial in chosen.episodes if not (trial.traffic.vehicles or trial.traffic.pedestrians)]
    # What is scored is float32 throughout, as in the exported file.
    with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
        driven = drive(
            model_of(found, place),
            trials,
            track="segmentation" if config.track == "segmentation" and "rgb" not in config.keys else "camera",
            device=place,
            threads=threads or len(os.sched_getaffinity(0)),
            batch=batch,
        )
    return {
        "agent": config.algorithm,
        "seed": found["seed"],
        "variant": config.variant,
        "suite": chosen.id,
        "suite_sha256": chosen.sha256,
        "driven": "in process",
        "steps": found["steps"],
        "device": torch.cuda.get_device_name() if place.type == "cuda" else "cpu",
        "trials": {
            trial.id: {
                "verdict": str(outcome.verdict),
                "reaction": str(outcome.reaction) if outcome.reaction else None,
                "clean": outcome.journey.clean if outcome.journey else None,
            }
            for trial, outcome in driven
        },
    }


def write_results(path: Path, results: Results) -> None:
    """Write results as JSON in one go, the same bytes for the same results.

    Raises:
        TrainingError: it cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = path.with_name(f".{path.name}.new")
        with beside.open("w", encoding="utf-8") as file:
            file.write(json.dumps(results, indent=1, sort_keys=True) + "\n")
            file.flush()
            os.fsync(file.fileno())
        beside.replace(path)
    except OSError as error:
        raise _unwritable(path, error.strerror) from error


def see_writable(path: Path) -> None:
    """See to it, before anything is driven, that results can be written there.

    Raises:
        TrainingError: they cannot.
    """
    if path.is_dir():
        raise _unwritable(path, "it is a directory")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise _unwritable(path, error.strerror) from error


def _unwritable(path: Path, reason: str | None) -> TrainingError:
    return TrainingError(f"--json: {path} cannot be written ({reason}); name another file")


def summary(results: Results) -> Iterator[str]:
    """Verdicts by town and kind of trial, a line each."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for trial, found in results["trials"].items():
        town, _, rest = trial.partition(".")
        kind = next((part for part in rest.split(".") if part.islower()), rest)
        counts.setdefault((town, kind), Counter())[found["verdict"]] += 1
    for (town, kind), verdicts in sorted(counts.items()):
        told = ", ".join(f"{verdict} {count}" for verdict, count in verdicts.most_common())
        yield f"{town} {kind}: {told}"


def _main() -> None:
    """As ``wrongturn score``, where there is this package and no program."""
    parser = argparse.ArgumentParser(prog="python -m wrongturn_agents.training.score")
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--suite", default="wrong-command@1")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--threads", type=int)
    parser.add_argument("--batch", type=int)
    arguments = vars(parser.parse_args())
    path = arguments.pop("json")
    if path is not None:
        see_writable(path)
    results = score(**arguments)
    print("\n".join(summary(results)))
    if path is not None:
        write_results(path, results)


if __name__ == "__main__":
    _main()
