"""Which agents there are, and how one is named.

An agent is named in one of three ways: a registered name (``careful``), a class of one's own
(``package.module:Class``), or an ONNX file (``model.onnx``).
"""

import importlib
import inspect
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from pydantic import BaseModel, ConfigDict

from wrongturn_agents.agent import Agent, kind_of_agent, track_of_agent
from wrongturn_agents.baselines import AlwaysStops, Careful, IgnoresCommands, ObeysBlindly, Parked
from wrongturn_agents.errors import (
    AgentFailedError,
    AgentImportError,
    AgentsError,
    ModelFileError,
    NotAnAgentError,
    UnknownAgentError,
)
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS, ShippedAgent
from wrongturn_client.invocation import program
from wrongturn_protocol import AgentKind, Track

AGENTS: Final = MappingProxyType(
    {agent.name: agent for agent in (Parked, AlwaysStops, IgnoresCommands, ObeysBlindly, Careful)},
)
"""The baselines' classes by name."""


class AgentListing(BaseModel):
    """One shipped agent, as ``wrongturn agents`` lists it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    track: Track
    kind: AgentKind
    description: str


@dataclass(frozen=True)
class AgentSource:
    """An agent that was found, before it is made."""

    name: str
    """For the leaderboard, where the user gives none."""
    track: Track
    kind: AgentKind
    description: str
    make: Callable[[], Agent]
    """Makes a fresh one."""


def list_agents() -> list[AgentListing]:
    """The baselines and the trained agents; of those without weights it is said that they must be trained first."""
    baselines = [
        AgentListing(name=name, track=agent.track, kind=agent.kind, description=agent.description)
        for name, agent in AGENTS.items()
    ]
    trained = [
        AgentListing(name=name, track=agent.track, kind=agent.kind, description=_described(agent))
        for name, agent in SHIPPED_AGENTS.items()
    ]
    return [*baselines, *trained]


def _described(agent: ShippedAgent) -> str:
    if agent.file.is_file():
        return agent.description
    return f"{agent.description} No weights are shipped yet: train it ('{program()} train {agent.name}')."


def resolve(named: str) -> AgentSource:
    """Find an agent by what a user calls it.

    Args:
        named: A registered name, ``package.module:Class``, or the path of an ``.onnx`` file.

    Raises:
        UnknownAgentError: no agent is registered under the name.
        AgentImportError: the class cannot be imported.
        NotAnAgentError: the class lacks ``reset``, ``act`` or ``track``.
        ModelFileError: the file is missing, broken or does not keep to the contract.
        OnnxRuntimeMissingError: the extra ``onnx`` is not installed; of a trained agent it is told when it is made.
    """
    if named in AGENTS:
        return _source(named, AGENTS[named])
    if named in SHIPPED_AGENTS:
        return _shipped(SHIPPED_AGENTS[named])
    if named.endswith(".onnx"):
        return _model(Path(named))
    if ":" in named:
        return _source(named, _imported(named))
    known = ", ".join((*AGENTS, *SHIPPED_AGENTS))
    raise UnknownAgentError(
        f"agent: there is no agent called {named!r}; known are {known}; or name package.module:Class or a .onnx file",
    )


def _imported(named: str) -> Any:
    module_name, _, attribute = named.partition(":")
    if not module_name:
        raise AgentImportError(f"agent: {named}: no module before the colon; write package.module:Class")
    if "" not in sys.path:
        sys.path.insert(0, "")  # a class in the working directory, as with python -m
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # a user's module may fail in any way while it is imported
        raise AgentImportError(f"agent: {module_name} cannot be imported: {type(error).__name__}: {error}") from error
    found: Any = module
    for part in attribute.split("."):
        found = getattr(found, part, None)
    if found is None:
        raise AgentImportError(f"agent: module {module_name} has no {attribute or 'class name after the colon'}")
    return found


def _source(named: str, agent: Any) -> AgentSource:
    """Read what a class says of itself."""
    if not inspect.isclass(agent):
        raise NotAnAgentError(f"agent: {named} is no class; name a class with reset, act and track")
    missing = [name for name in ("reset", "act") if not callable(getattr(agent, name, None))]
    if missing:
        raise NotAnAgentError(f"agent: {named} has no method {' and no '.join(missing)}; see wrongturn_agents.agent")
    track = track_of_agent(agent)
    if track is None:
        said = repr(getattr(agent, "track", None))
        tracks = ", ".join(Track)
        raise NotAnAgentError(f"agent: {named}.track is {said}; set the class attribute to one of {tracks}")
    description = getattr(agent, "description", None) or (inspect.getdoc(agent) or "").partition("\n")[0]
    return AgentSource(
        name=str(getattr(agent, "name", agent.__name__)),
        track=track,
        kind=kind_of_agent(agent),
        description=str(description),
        make=partial(_make, named, agent),
    )


def _make(named: str, agent: Callable[[], Any]) -> Agent:
    try:
        made: Agent = agent()
    except TypeError as error:
        raise NotAnAgentError(f"agent: {named} cannot be made without arguments: {error}") from error
    except AgentsError:
        raise
    except Exception as error:
        raise AgentFailedError(f"agent: {named} raised {type(error).__name__} when it was made: {error}") from error
    return made


def _shipped(agent: ShippedAgent) -> AgentSource:
    return AgentSource(agent.name, agent.track, agent.kind, agent.description, make=agent.make)


def _model(file: Path) -> AgentSource:
    if not file.is_file():
        raise ModelFileError(f"agent: {file}: there is no such file; name an .onnx file")
    from wrongturn_agents.onnx_agent import OnnxAgent  # noqa: PLC0415 - loads an optional extra

    agent = OnnxAgent(file)
    return AgentSource(agent.name, agent.track, agent.kind, agent.description, make=lambda: agent)
