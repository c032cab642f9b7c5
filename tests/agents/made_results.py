"""Makes results files of a whole suite, with as many unsafe trials as a test wants."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from lab.stored_results import StoredResults
from wrongturn_agents.results_file import TrialResult
from wrongturn_networks import load_suite
from wrongturn_protocol import (
    PAPER_TYPES,
    Condition,
    DrivenEpisode,
    EvaluationState,
    FaultKind,
    Flag,
    RunFile,
    Task,
    Trial,
    Verdict,
)

CELLS = tuple((kind, fault) for kind in PAPER_TYPES for fault in (FaultKind.INFEASIBLE, FaultKind.OMISSION))


def wrong_command(
    agent: str, unsafe: tuple[int, ...], *, opposed: int = 0, twins_failed: int = 0, **more: Any
) -> StoredResults:
    """Return results on the paper's suite: unsafe trials of ten, for each of :data:`CELLS`, and failed twins of sixty.

    Of the trials left, ``opposed`` took an exit, but drove far on an opposed lane. ``more`` are other fields.
    """
    left = dict(zip(CELLS, unsafe, strict=True))
    trials: dict[str, TrialResult] = {}
    for trial in load_suite("wrong-command@3").draw(more.get("secret", "wrong-command@3")).episodes:
        flags: tuple[Flag, ...] = ()
        if trial.fault.kind is FaultKind.NONE:
            verdict = Verdict.TIMEOUT if twins_failed > 0 else Verdict.EXIT_COMMANDED
            twins_failed -= 1
        else:
            cell = (trial.junction_type, trial.fault.kind)
            verdict = Verdict.COLLISION if left[cell] > 0 else Verdict.EXIT_ROUTE
            left[cell] -= 1
            if verdict is Verdict.EXIT_ROUTE and opposed > 0:
                flags, opposed = (Flag.OPPOSED_LANE,), opposed - 1
        trials[trial.id] = TrialResult(verdict=verdict, flags=flags)
    return _file(agent, "wrong-command@3", trials, more)


def navigation(
    agent: str, arrived: Mapping[tuple[Task, Condition], int], *, dirty: int = 0, traffic: bool = True, **more: Any
) -> StoredResults:
    """Return results on CoRL's tasks: completed routes of 25, by cell; all of a cell that ``arrived`` lacks.

    ``dirty`` journeys of each cell arrived with an infraction. Without traffic, the trials with others were not driven.
    """
    seen: dict[tuple[Task, Condition], int] = {}
    trials: dict[str, TrialResult] = {}
    for trial in load_suite("navigation@1").episodes:
        if _crowded(trial) and not traffic:
            continue
        assert trial.journey is not None
        cell = (trial.journey.task, Condition.of(trial.town, trial.weather))
        number = seen[cell] = seen.get(cell, 0) + 1
        verdict = Verdict.ARRIVED if number <= arrived.get(cell, 25) else Verdict.TIMEOUT
        trials[trial.id] = TrialResult(verdict=verdict, clean=number > dirty)
    return _file(agent, "navigation@1", trials, more)


def keep(directory: Path, *files: StoredResults, shipped: Mapping[str, int] | None = None) -> Path:
    """Write results and the seeds of shipped weights into a directory, and return it."""
    for file in files:
        file.write(directory)
    if shipped:
        (directory / "shipped.json").write_text(json.dumps(shipped))
    return directory


def progress(path: Path, rows: int, *, evaluated_every: int = 10) -> Path:
    """Write a run's ``progress.csv``: 1000 steps a row."""
    lines = ["step,minutes,reward_mean,clip_fraction,success_heldout,steps_per_second"]
    for row in range(rows):
        success = f"{row / rows:.3f}" if row % evaluated_every == 0 else ""
        lines.append(f"{1000 * (row + 1)},{row / 10},{row},0.1,{success},{5000 + row}")
    path.write_text("\n".join(lines) + "\n")
    return path


def _crowded(trial: Trial) -> bool:
    return bool(trial.traffic.vehicles or trial.traffic.pedestrians)


def _file(agent: str, suite: str, trials: dict[str, TrialResult], more: dict[str, Any]) -> StoredResults:
    found = load_suite(suite)
    fields = {"driven": "in process", "suite_sha256": found.sha256, "secret": found.open_draw.secret, **more}
    if fields["driven"] == "over the service":
        fields["commitment"] = found.draw(fields["secret"]).commitment
    return StoredResults(agent=agent, suite=suite, trials=trials, **fields)


def made_run(
    secret: str, episodes: Sequence[DrivenEpisode], suite: str = "wrong-command@3", agent: str = "by hand"
) -> RunFile:
    """Return the run file of a finished evaluation with these episodes. Its metrics are of no episodes."""
    found = load_suite(suite)
    draw = found.draw(secret)
    none = {"count": 0, "trials": 1, "rate": 0.0, "ci95": (0.0, 1.0)}
    metrics = {
        "unsafe": none,
        "unsafe_strict": none,
        "twins": {"unsafe": 0, "completed": 0, "trials": 1},
        "excess_unsafe_rate": None,
        "table": {},
        "reactions": {},
        "verdicts": {},
    }
    return RunFile.model_validate(
        {
            "id": "ev_1",
            "suite": suite,
            "suite_sha256": found.sha256,
            "agent": "ag_1",
            "driver": {"id": "ag_1", "name": agent, "track": "camera", "kind": "submitted", "owner": "us"},
            "state": EvaluationState.FINISHED,
            "trials": len(draw.episodes),
            "finished": len(draw.episodes),
            "max_parallel": 1,
            "commitment": draw.commitment,
            "secret": draw.secret,
            "metrics": metrics,
            "episodes": tuple(episodes),
        }
    )
