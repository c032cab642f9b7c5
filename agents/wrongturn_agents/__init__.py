"""Agents, and the worker that drives them against a service.

Names are imported on first use, so that ``wrongturn --help`` starts quickly.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from wrongturn_agents.agent import Agent
    from wrongturn_agents.errors import AgentsError
    from wrongturn_agents.registry import AGENTS, AgentListing, AgentSource, list_agents, resolve

__all__ = ["AGENTS", "Agent", "AgentListing", "AgentSource", "AgentsError", "list_agents", "resolve"]

_HOMES: Final = {"Agent": "agent", "AgentsError": "errors"}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOMES.get(name, 'registry')}"), name)
    globals()[name] = value
    return value
