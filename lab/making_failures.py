"""Makes the study of failures and its films, ``python -m lab.results --failures``."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from lab.failures import (
    FILMS,
    Failures,
    FilmedAgent,
    failures_file,
    outdated,
    stored_results,
)
from lab.making_studies import check_extra, threads
from lab.paths import LAB
from lab.weights import learned_agents, weights_sha256
from wrongturn_agents.errors import ResultsError
from wrongturn_agents.progress import ProgressStyle, show_progress
from wrongturn_agents.registry import resolve
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.stored_results import Collection
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite
from wrongturn_protocol import FaultKind, JunctionType


def make_failures(directory: Path, agents: Sequence[str]) -> Path:
    """Drive the unsafe trials of learned agents again, measure and film them, and store what was seen.

    An agent whose weights and results are those of the stored study is not driven again. The study is written after
    each agent, so an interrupted run goes on where it stopped.

    Args:
        directory: Directory of the stored results.
        agents: Names of the agents; all learned ones whose weights are shipped if empty.

    Returns:
        Path of the study.

    Raises:
        MissingPackageError: The extra ``training`` is not installed.
        ResultsError: An agent is not a learned one, its trials end otherwise than stored, or this is not the
            repository's root.
        AgentsError: An agent fails, or the study cannot be written.
    """
    check_extra("--failures")
    from wrongturn_agents.training.in_process import VERSION

    unknown = sorted(set(agents) - set(learned_agents()))
    if unknown:
        raise ResultsError(f"--agent: {unknown[0]} has no shipped weights; choose of {', '.join(learned_agents())}")
    if not FILMS.parent.is_dir():
        raise ResultsError(f"--failures: there is no {FILMS.parent} here; go to the repository's root")
    path, collection = failures_file(LAB), Collection.read(directory)
    study = Failures.of(WRONG_COMMAND, installed_suite(WRONG_COMMAND).sha256, VERSION, Failures.read(path))
    names = tuple(agents or learned_agents())
    for make in (_with_ways, _with_journeys):
        for name in names:
            known = study.agents.get(name)
            made = make(name, collection, known)
            if made is not known:
                study = study.model_copy(update={"agents": {**study.agents, name: made}})
                study.write(path)
    _tidy(study)
    return path


def _with_ways(name: str, collection: Collection, known: FilmedAgent | None) -> FilmedAgent:
    """Return an agent's part of the study with the films of the ways in which its trials end."""
    from lab.filming import study as filming

    if known is not None and outdated(collection, name, known) is None:
        return known
    FILMS.mkdir(exist_ok=True)
    stored = stored_results(collection, name)
    cells: Counter[tuple[JunctionType, FaultKind]] = Counter()
    for other in learned_agents():
        found = stored_results(collection, other)
        for way, trials in ({} if found is None else found.unsafe_ways()).items():
            cells[way.cell] += len(trials)
    weights = weights_sha256(name)
    assert weights is not None  # a learned agent has some
    with show_progress(ProgressStyle.AUTO, f"{name}, films") as progress:
        filmer = filming.Filmer(resolve(name), FILMS, threads(), progress)
        ended = filmer.drive_open_draw() if stored is None else stored
        ways = filmer.ways(ended, cells)
    return FilmedAgent(
        weights_sha256=weights,
        secret=ended.secret,
        results=dict(sorted(ended.results.items())) if stored is None else None,
        ways=ways,
        journeys=None if name in SHIPPED_AGENTS else (),
    )


def _with_journeys(name: str, _: Collection, known: FilmedAgent | None) -> FilmedAgent:
    """Return an agent's part of the study with its journeys beside traffic."""
    from lab.filming import study as filming

    assert known is not None  # the ways come first
    if known.journeys is not None:
        return known
    with show_progress(ProgressStyle.AUTO, f"{name}, beside traffic") as progress:
        driven = filming.Filmer(resolve(name), FILMS, threads(), progress).journeys()
    return known.model_copy(update={"journeys": driven})


def _tidy(study: Failures) -> None:
    """Remove films that nothing shows any more."""
    for path in FILMS.glob("*.webp"):
        if path.name not in study.films():
            path.unlink()
