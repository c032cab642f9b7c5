"""Drive a whole suite with a checkpoint in this process, without a service."""

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import torch

from wrongturn_agents.registry import resolve
from wrongturn_agents.results_file import ResultsFile, TrialResult
from wrongturn_agents.stored_results import STORED, Collection
from wrongturn_agents.training.devices import device_of
from wrongturn_agents.training.drive import drive_trials, is_driver
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.in_process import drive_in_process
from wrongturn_agents.training.method import load
from wrongturn_networks import Suite, load_suite
from wrongturn_protocol import Outcome, Traffic, Trial

Results = dict[str, Any]
"""Fields of a :class:`~wrongturn_agents.results_file.ResultsFile`."""


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
        suite: id of the suite. Example: ``wrong-command@2``. Of a suite that draws its trials, the
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
    chosen = load_suite(suite)
    trials, track = _trials_of(chosen, traffic=traffic), loaded.agent.track
    # Everything in float32, as in the exported file.
    with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
        (driven,) = drive_trials(
            [loaded.model], trials, track=track, device=place, threads=threads or _cores(), batch=batch
        )
    return _results(
        chosen,
        ((one.trial, one.outcome) for one in driven),
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
    source = resolve(name)
    chosen = load_suite(suite)
    driven = drive_in_process(source, _trials_of(chosen, traffic=traffic), threads=threads or _cores())
    seed = Collection.read(STORED).shipped.get(source.name)
    return _results(chosen, ((one.trial, one.outcome) for one in driven), agent=source.name, seed=seed, device="cpu")


def _cores() -> int:
    return len(os.sched_getaffinity(0))


def _results(suite: Suite, driven: Iterable[tuple[Trial, Outcome | None]], **facts: Any) -> Results:
    return ResultsFile(
        suite=suite.id,
        suite_sha256=suite.sha256,
        secret=suite.open_draw.secret,
        driven="in process",
        trials={trial.id: TrialResult.of(outcome) for trial, outcome in driven if outcome is not None},
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
