"""Which weights an agent drives with, so that what was stored of others is noticed."""

import hashlib
from pathlib import Path

from wrongturn_agents.doubting_agent import DOUBTING_AGENTS
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS


def learned_agents() -> tuple[str, ...]:
    """Return the names of the learned agents whose weights are shipped."""
    return tuple(name for name in (*SHIPPED_AGENTS, *DOUBTING_AGENTS) if all(file.is_file() for file in _files(name)))


def weights_sha256(name: str) -> str | None:
    """Return the SHA-256 of an agent's weights, of all its files together; None if it has none.

    Args:
        name: Name of an agent, or path of an ONNX file.
    """
    found = hashlib.sha256()
    for file in _files(name):
        if not file.is_file():
            return None
        found.update(file.read_bytes())
    return found.hexdigest()


def _files(name: str) -> tuple[Path, ...]:
    if name in DOUBTING_AGENTS:
        return DOUBTING_AGENTS[name].files
    return (SHIPPED_AGENTS[name].file if name in SHIPPED_AGENTS else Path(name),)
