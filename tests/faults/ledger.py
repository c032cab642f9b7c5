"""What must hold when all is over: what was acknowledged is there, once, and as if nothing had happened."""

import hashlib
import json
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from databases import Store

SLACK_S = 1.0
"""Seconds by which the time of a kill and that in a row may differ: both are taken a moment after."""
RESULT = ("verdict", "outcome", "steps", "actions_sha256", "trajectory_sha256")
"""What of an episode must be the same in a run that is disturbed."""


def journal(paths: Sequence[Path]) -> list[dict[str, Any]]:
    """All lines of the workers' journals; one that was cut off by a kill was never written."""
    lines = [line for path in paths if path.exists() for line in path.read_text().splitlines()]
    return [json.loads(line) for line in lines]


def results(store: Store, evaluation: str) -> dict[str, tuple[Any, ...]]:
    """By trial, what its finished episode came to."""
    rows = store.rows(f"SELECT * FROM episodes WHERE state = 'finished' AND evaluation_id = '{evaluation}'")
    return {row["trial_id"]: tuple(row[name] for name in RESULT) for row in rows}


@dataclass
class Findings:
    """What was found; the lists are empty where all is well."""

    evaluations: int = 0
    finished: int = 0
    acknowledged: int = 0
    """Last replies that clients received, repetitions counted once."""
    lost: list[str] = field(default_factory=list)
    """Acknowledged, and not in the database as they were told."""
    twice: list[str] = field(default_factory=list)
    """Trials that count twice in an evaluation, or in its metrics."""
    cut_off: list[str] = field(default_factory=list)
    """Episodes that have a verdict which nobody drove to."""
    differing: list[str] = field(default_factory=list)
    """Trials whose verdict, actions or trajectory are not those of the undisturbed drive."""
    unfinished: list[str] = field(default_factory=list)
    unexplained: list[str] = field(default_factory=list)
    """Episodes given up though neither the service nor its database was killed while they were open."""
    damaged: list[str] = field(default_factory=list)
    """Trajectories that are not what their checksum says, or are missing."""
    voided: Counter[str] = field(default_factory=Counter)
    """Episodes that were given up and driven again, by reason."""

    @property
    def bad(self) -> dict[str, list[str]]:
        """By name, what there must be none of."""
        names = ("lost", "twice", "cut_off", "differing", "unfinished", "unexplained", "damaged")
        return {name: found for name in names if (found := getattr(self, name))}


def examine(
    store: Store,
    undisturbed: Mapping[str, dict[str, tuple[Any, ...]]],
    told: Sequence[dict[str, Any]],
    disturbances: Sequence[float],
) -> Findings:
    """Compare the database with what was told and with undisturbed drives.

    Args:
        store: the database, after all.
        undisturbed: for each evaluation that was driven meanwhile, what its trials come to when nothing is killed, as
            :func:`results` has it.
        told: the journal.
        disturbances: times of kills of the service and of the database's server, which alone may cost an episode.
    """
    found = Findings(evaluations=len(undisturbed))
    episodes = {row["id"]: row for row in store.rows("SELECT * FROM episodes")}
    finals = {(line["episode"], line["seq"]) for line in told if line["what"] == "final"}
    found.acknowledged = len(finals)
    for name, seq in sorted(finals):
        row = episodes.get(name)
        if row is None or row["state"] != "finished" or row["steps"] != seq:
            found.lost.append(f"{name} at {seq}: {row and (row['state'], row['steps'])}")
    done = {row["id"]: row for row in store.rows("SELECT id, state, trials, metrics FROM evaluations")}
    for line in told:
        if line["what"] == "finished" and done.get(line["evaluation"], {}).get("state") != "finished":
            found.lost.append(f"the end of {line['evaluation']}")
    for evaluation, expected in undisturbed.items():
        _examine_one(found, done[evaluation], [row for row in episodes.values() if row["evaluation_id"] == evaluation])
        got = results(store, evaluation)
        for trial, wanted in expected.items():
            if got.get(trial) != wanted:
                found.differing.append(f"{evaluation} {trial}: {got.get(trial)} and not {wanted}")
    for row in episodes.values():
        if row["state"] == "lost":
            reason = "simulators failed" if row["verdict"] == "invalid" else "service ended"
            found.voided[reason] += 1
            span = (row["created"] - SLACK_S, row["finished"] + SLACK_S)
            if row["verdict"] is None and not any(span[0] <= when <= span[1] for when in disturbances):
                found.unexplained.append(f"{row['id']}, open from {span[0]:.1f} to {span[1]:.1f}")
    _examine_trajectories(found, store, episodes)
    return found


def _examine_one(found: Findings, evaluation: dict[str, Any], episodes: list[dict[str, Any]]) -> None:
    name = evaluation["id"]
    scored = [row for row in episodes if row["state"] == "finished"]
    counts = Counter(row["trial_id"] for row in scored)
    found.finished += len(scored)
    found.twice += [f"{name} {trial}: {count} times" for trial, count in counts.items() if count > 1]
    found.cut_off += [
        f"{name} {row['trial_id']}: {row['verdict']}" for row in scored if row["verdict"] in {"aborted", "invalid"}
    ]
    if evaluation["state"] != "finished" or len(counts) != evaluation["trials"] or not evaluation["metrics"]:
        found.unfinished.append(f"{name}: {evaluation['state']}, {len(counts)} of {evaluation['trials']}")
        return
    verdicts = json.loads(evaluation["metrics"])["verdicts"]
    if (counted := sum(sum(counts.values()) for counts in verdicts.values())) != evaluation["trials"]:
        found.twice.append(f"{name}: {counted} verdicts in the metrics")


def _examine_trajectories(found: Findings, store: Store, episodes: dict[str, dict[str, Any]]) -> None:
    kept = {row["episode_id"]: row for row in store.rows("SELECT * FROM trajectories")}
    for name, row in episodes.items():
        stored = kept.get(name)
        if row["state"] != "finished":
            if stored is not None:
                found.damaged.append(f"{name}: a trajectory of an episode that did not end")
        elif stored is None:
            found.damaged.append(f"{name}: no trajectory")
        elif hashlib.sha256(zlib.decompress(stored["data"])).hexdigest() != row["trajectory_sha256"]:
            found.damaged.append(f"{name}: another trajectory")
