"""The environment of processes that the service starts. Its own has the operator's token and other secrets."""

import os
from collections.abc import Mapping
from typing import Final

_PASSED_ON: Final = ("PATH", "HOME", "LANG", "LC_ALL", "TZ", "TMPDIR", "PYTHONPATH", "LD_LIBRARY_PATH")
"""Variables that every child gets: where programs, modules and temporary files are, and the language."""
NICE: Final = 5
"""A runner gives way to simulators, which other agents use too."""


def child_environment(*more: str, environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return those of the service's variables that a child may have; ``more`` names others, which hold no secrets."""
    return {name: environment[name] for name in (*_PASSED_ON, *more) if name in environment}
