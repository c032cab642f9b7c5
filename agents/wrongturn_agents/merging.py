"""Merges results files that are pieces of one run: ``wrongturn results --merge``."""

from collections.abc import Sequence
from pathlib import Path

from wrongturn_agents.errors import ResultsError
from wrongturn_agents.results_file import ResultsFile, read_runs


def merge(files: Sequence[Path]) -> tuple[ResultsFile, ...]:
    """Return the runs of which some files are the pieces, for example those of ``--shard``.

    Raises:
        ResultsError: There is no file, one is not a results file, they are of different runs, two have the same trial,
            or trials are missing.
    """
    if not files:
        raise ResultsError("--merge: there is no file; name the pieces of a run")
    whole = read_runs(files[0])
    seen: dict[tuple[int, str], Path] = {(k, name): files[0] for k, run in enumerate(whole) for name in run.trials}
    for file in files[1:]:
        piece = read_runs(file)
        _check_same_run(files[0], whole, file, piece)
        for number, run in enumerate(piece):
            for name in run.trials:
                if (other := seen.setdefault((number, name), file)) is not file:
                    raise ResultsError(f"--merge: {other} and {file} both have {name}; name each piece once")
        whole = tuple(
            one.model_copy(update={"trials": {**one.trials, **more.trials}})
            for one, more in zip(whole, piece, strict=True)
        )
    for run in whole:
        _check_complete(run)
    return whole


def _check_same_run(first: Path, whole: Sequence[ResultsFile], file: Path, piece: Sequence[ResultsFile]) -> None:
    """Check that two files have runs of the same agents and draws. Raises ResultsError."""
    remedy = "merge pieces of one run"
    if len(piece) != len(whole):
        raise ResultsError(f"--merge: {file} has {len(piece)} runs, and {first} has {len(whole)}; {remedy}")
    for mine, theirs in zip(whole, piece, strict=True):
        for field in ResultsFile.model_fields:
            if field != "trials" and getattr(mine, field) != getattr(theirs, field):
                raise ResultsError(
                    f"--merge: {field}: is {getattr(theirs, field)} in {file}, and {getattr(mine, field)} in {first}; "
                    f"{remedy}"
                )


def _check_complete(run: ResultsFile) -> None:
    """Check that a run has every trial of its draw, and no other. Raises ResultsError."""
    trials = run.drawn.trials
    lacking = sorted(trials.keys() - run.trials)
    if lacking:
        raise ResultsError(
            f"--merge: trials: {len(lacking)} of {len(trials)} of {run.agent} are missing, such as {lacking[0]}; "
            "name the file of each shard, and finish shards that were interrupted by the same command"
        )
    run.check("--merge")
