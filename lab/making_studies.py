"""Makes the stored studies, ``python -m lab.results --sensitivity`` and ``--draws``."""

import os
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from lab.studies import (
    DrawnAgent,
    Draws,
    Judgings,
    draws_file,
    judgings_file,
    secrets_of_draws,
)
from lab.weights import weights_sha256
from wrongturn_agents.errors import MissingPackageError
from wrongturn_agents.progress import ProgressStyle, show_progress
from wrongturn_agents.registry import AGENTS, EXPLOITS, resolve
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.suites import WRONG_COMMAND, installed_suite

_NEEDED: Final = {"wrongturn_sim": "wrongturn-service", "onnxruntime": "onnxruntime", "scipy": "scipy"}


def make_judgings(directory: Path, agents: Sequence[str]) -> Path:
    """Drive the open draw, judge it by other thresholds, and store what changes.

    An agent that the stored study has, with the same weights, thresholds and suite, is not driven again. The study is
    written after each agent, so an interrupted run goes on where it stopped.

    Args:
        directory: Directory of the stored results.
        agents: Names of the agents; all shipped ones and the exploits that only drive if empty.

    Returns:
        Path of the study.

    Raises:
        MissingPackageError: The extra ``training`` is not installed.
        AgentsError: An agent does not exist or fails, or the study cannot be written.
    """
    check_extra("--sensitivity")
    from lab.judging import judge_agent
    from wrongturn_agents.training.in_process import VERSION

    path = judgings_file(directory)
    found = Judgings.read(path)
    study = Judgings.of(WRONG_COMMAND, installed_suite(WRONG_COMMAND).sha256, VERSION, found)
    for name in agents or (*_shipped(), *EXPLOITS):
        weights = weights_sha256(name)
        if name in study.agents and study.agents[name].weights_sha256 == weights:
            continue
        source = resolve(name)
        with show_progress(ProgressStyle.AUTO, name) as progress:
            judged = judge_agent(source, weights, threads=threads(), progress=progress)
        study = study.model_copy(update={"agents": {**study.agents, name: judged}})
        study.write(path)
    return path


def make_draws(directory: Path, agents: Sequence[str], count: int) -> Path:
    """Drive a number of draws, and store how many trials of each are unsafe.

    A draw that the stored study has is not driven again, as in :func:`make_judgings`.

    Args:
        directory: Directory of the stored results.
        agents: Names of the agents; all shipped ones if empty.
        count: Number of draws.

    Returns:
        Path of the study.

    Raises:
        MissingPackageError: The extra ``training`` is not installed.
        AgentsError: An agent does not exist or fails, or the study cannot be written.
    """
    check_extra("--draws")
    from lab.drawing import drive_draw
    from wrongturn_agents.training.in_process import VERSION

    path = draws_file(directory)
    study = Draws.of(WRONG_COMMAND, installed_suite(WRONG_COMMAND).sha256, VERSION, Draws.read(path))
    for name in agents or _shipped():
        source, weights = resolve(name), weights_sha256(name)
        agent = study.agents.get(name)
        if agent is None or agent.weights_sha256 != weights:
            agent = DrawnAgent(weights_sha256=weights, draws={})
        for secret in secrets_of_draws(count):
            if secret in agent.draws:
                continue
            with show_progress(ProgressStyle.AUTO, f"{name}, {secret}") as progress:
                counts = drive_draw(source, WRONG_COMMAND, secret, threads=threads(), progress=progress)
            agent = agent.model_copy(update={"draws": {**agent.draws, secret: counts}})
            study = study.model_copy(update={"agents": {**study.agents, name: agent}})
            study.write(path)
    return path


def check_extra(option: str) -> None:
    """Check that what driving needs is installed.

    Raises:
        MissingPackageError: A package is missing. The error says what to install.
    """
    missing = [package for module, package in _NEEDED.items() if find_spec(module) is None]
    if missing:
        raise MissingPackageError(
            f"{option}: drives agents in this process, which needs {', '.join(missing)}; "
            "install wrongturn-agents[training]"
        )


def _shipped() -> list[str]:
    """Return the names of the baselines, and of the trained agents with weights."""
    return [*AGENTS, *(name for name, agent in SHIPPED_AGENTS.items() if agent.file.is_file())]


def threads() -> int:
    """Return the number of threads that drive: one for each core that this process may use."""
    return len(os.sched_getaffinity(0))
