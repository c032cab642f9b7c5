"""Finds agents by name.

A name is one of four things: a registered name (``careful``), your own class (``package.module:Class``), an ONNX file
(``model.onnx``), or what Stable-Baselines3 saved (``model.zip``).
"""

import importlib
import inspect
import logging
import sys
from collections.abc import Callable, Iterable, Iterator
from copy import copy
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from pydantic import BaseModel, ConfigDict

from wrongturn_agents.agent import Agent, kind_of_agent, track_of_agent, try_out
from wrongturn_agents.baselines import AlwaysStops, Careful, IgnoresCommands, ObeysBlindly, Parked
from wrongturn_agents.errors import (
    AgentFailedError,
    AgentImportError,
    AgentsError,
    MissingPackageError,
    ModelFileError,
    NotAnAgentError,
    UnknownAgentError,
    why_no_file,
)
from wrongturn_agents.onnx_agent import OnnxAgent
from wrongturn_agents.shipped_agents import DOUBTING_AGENTS, SHIPPED_AGENTS, trained_with
from wrongturn_agents.words_agent import LbcWords
from wrongturn_client.errors import PluginError
from wrongturn_client.invocation import program
from wrongturn_client.plugins import entry_points, load
from wrongturn_protocol import AgentKind, Rig, RigError, Sight, Track
from wrongturn_protocol.installing import install
from wrongturn_protocol.rigs import rig_of, sight_of
from wrongturn_protocol.suggestions import did_you_mean

AGENTS: Final = MappingProxyType(
    {agent.name: agent for agent in (Parked, AlwaysStops, IgnoresCommands, ObeysBlindly, Careful)}
)
"""Classes of the baselines by name."""
GROUP: Final = "wrongturn.agents"
"""Entry-point group of agents from other packages: each names a class, by the name that users give."""
FILES: Final = "wrongturn.files"
"""Entry-point group of classes that drive with a file, by the end of its name."""
_TRAINED: Final = MappingProxyType({**SHIPPED_AGENTS, **DOUBTING_AGENTS})
_WORDS: Final = MappingProxyType({LbcWords.name: LbcWords})
"""Classes that drive by sentences."""

ZIP: Final = ".zip"
"""End of the names of files that Stable-Baselines3 saved."""
_PY: Final = ".py"
_SHOWN: Final = 80
"""Longest part of an unknown name in an error."""


class AgentListing(BaseModel):
    """An agent that comes with this package, as ``wrongturn agents`` lists it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    track: Track
    kind: AgentKind
    description: str


@dataclass(frozen=True)
class AgentSource:
    """An agent that was found, and how to make it."""

    name: str
    """Name on the leaderboard if the user gives none."""
    track: Track
    kind: AgentKind
    description: str
    make: Callable[[], Agent]
    """Makes a new agent."""
    trained_on_faults: bool = False
    """Whether it met wrong commands in its training."""
    code: tuple[Path, ...] = ()
    """Files of its code or weights: another agent drives if one of them changes."""
    rig: Rig | None = None
    """Its rig; None: what its track shows."""

    @property
    def sight(self) -> Sight:
        """What it is shown."""
        return self.rig or self.track


def list_agents() -> list[AgentListing]:
    """Return the baselines, the trained agents, and the agents of other packages.

    The description says which must be trained first.
    """
    return [
        AgentListing(name=agent.name, track=agent.track, kind=agent.kind, description=_description(agent))
        for agent in (*AGENTS.values(), *_TRAINED.values(), *_WORDS.values())
    ] + [*_listed_of_others()]


def _listed_of_others() -> Iterator[AgentListing]:
    for name, point in entry_points(GROUP).items():
        try:
            found = _source(name, load(point))
        except (PluginError, NotAnAgentError) as error:  # the rest works
            logging.getLogger(__name__).warning("%s is left out: %s", name, error)
        else:
            yield AgentListing(name=name, track=found.track, kind=found.kind, description=found.description)


def _description(agent: Any) -> str:
    described = _described(agent)
    if agent.name not in _TRAINED or agent.file.is_file():
        return described
    algorithm, _ = trained_with(agent.name)
    return f"{described} No weights are shipped yet: train it ('{program()} train {algorithm}')."


def resolve(named: str) -> AgentSource:
    """Find an agent by name, class or file.

    Args:
        named: A registered name, ``package.module:Class``, or the path of an ``.onnx`` or ``.zip`` file. A zip file
            of Stable-Baselines3 is loaded, which runs code that it names. Example: ``careful``

    Raises:
        UnknownAgentError: No agent is registered under the name.
        PluginError: The class of an agent from another package cannot be imported.
        AgentImportError: The class cannot be imported.
        NotAnAgentError: The class lacks ``reset``, ``act`` or ``track``.
        ModelFileError: The file is missing or broken, breaks the contract, or fails on a made-up observation.
        OnnxRuntimeMissingError: The extra ``onnx`` is not installed. A trained agent raises it only when it is made.
        MissingPackageError: A ``.zip`` file needs the extra ``training``, which is not installed.
    """
    if (agent_class := AGENTS.get(named) or _WORDS.get(named)) is not None:
        return _source(named, agent_class)
    if (shipped := _TRAINED.get(named)) is not None:
        return _made(shipped, shipped.make, [file for file in shipped.files if file.is_file()])
    others = entry_points(GROUP)
    if named in others:
        return _source(named, load(others[named]))
    if named.endswith(".onnx"):
        return _model(Path(named))
    if named.endswith(ZIP):
        return _saved_model(Path(named))
    if ":" in named:
        return _source(named, _import(named))
    if named.endswith(_PY):
        raise UnknownAgentError(f"agent: {named} is a file; write {_module_of(named)}:Class")
    known = (*AGENTS, *_TRAINED, *_WORDS, *others)
    raise UnknownAgentError(
        f"agent: there is no agent called {named[:_SHOWN]!r}; known are {', '.join(known)}; or name "
        f"package.module:Class, a .onnx file, or a .zip file of Stable-Baselines3{did_you_mean(named, known)}"
    )


def with_absolute_file(named: str) -> str:
    """Return an agent's name, with an absolute path if it is a file."""
    return str(Path(named).resolve()) if named.endswith((".onnx", ZIP)) else named


def _import(named: str) -> Any:
    module_name, _, attribute = named.partition(":")
    if not module_name:
        raise AgentImportError(f"agent: {named}: the module before the colon is missing; write package.module:Class")
    if module_name.endswith(_PY):
        raise AgentImportError(
            f"agent: {module_name} is a file; write {_module_of(module_name)}:{attribute or 'Class'}"
        )
    if "" not in sys.path:
        sys.path.insert(0, "")  # so that classes in the working directory are found, as with python -m
    try:
        module = importlib.import_module(module_name)
    except Exception as error:  # a user's module may raise anything
        raise AgentImportError(f"agent: {module_name} cannot be imported: {type(error).__name__}: {error}") from error
    found: Any = module
    for part in attribute.split("."):
        found = getattr(found, part, None)
    if found is None:
        classes = [name for name, value in vars(module).items() if inspect.isclass(value)]
        raise AgentImportError(
            f"agent: module {module_name} has no {attribute or 'class name after the colon'}"
            f"{did_you_mean(attribute, classes)}"
        )
    return found


def _module_of(file: str) -> str:
    """Return the name by which Python imports a file. Example: ``agents/mine.py`` is ``agents.mine``."""
    return ".".join(part for part in Path(file).with_suffix("").parts if part not in {"/", ".", ".."})


def _source(named: str, agent: Any) -> AgentSource:
    """Return the source of an agent's class, from its attributes."""
    if not inspect.isclass(agent):
        raise NotAnAgentError(f"agent: {named} is not a class; name a class with reset, act and track")
    missing = [name for name in ("reset", "act") if not callable(getattr(agent, name, None))]
    if missing:
        raise NotAnAgentError(f"agent: {named} has no method {' and no '.join(missing)}; see wrongturn_agents.agent")
    track = track_of_agent(agent)
    if track is None:
        said, tracks = repr(getattr(agent, "track", None)), ", ".join(Track)
        raise NotAnAgentError(f"agent: {named}.track is {said}; set the class attribute to one of {tracks}")
    rig = _rig_of(named, agent, track)
    return AgentSource(
        name=str(getattr(agent, "name", agent.__name__)),
        track=track,
        kind=kind_of_agent(agent),
        description=_described(agent),
        make=partial(_make, named, agent),
        trained_on_faults=getattr(agent, "trained_on_faults", False) is True,
        code=_files_of_class(agent),
        rig=rig,
    )


def _rig_of(named: str, agent: Any, track: Track) -> Rig | None:
    try:
        rig = rig_of(getattr(agent, "rig", None))
        sight_of(track, rig)
    except RigError as error:
        raise NotAnAgentError(f"agent: {named}.{error}") from error
    return rig


def _described(agent: Any) -> str:
    return str(getattr(agent, "description", None) or (inspect.getdoc(agent) or "").partition("\n")[0])


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


def _files_of_class(agent: type) -> tuple[Path, ...]:
    """Return the files in which a class and the classes that it is made of are written, without those of Python."""
    files: dict[Path, None] = {}
    for part in agent.__mro__:
        try:
            found = inspect.getsourcefile(part)
        except (TypeError, OSError):  # built in, or typed into an interpreter
            continue
        if found is not None and Path(found).is_file():
            files[Path(found).resolve()] = None
    return tuple(files)


def _model(file: Path) -> AgentSource:
    _check_file(file, "an .onnx file")
    agent = OnnxAgent(file)
    try_out(agent, agent.contract.sight)
    return _made(agent, partial(copy, agent), [file])


def _saved_model(file: Path) -> AgentSource:
    _check_file(file, "what model.save of Stable-Baselines3 wrote")
    point = entry_points(FILES).get(ZIP.removeprefix("."))
    if point is None:
        raise MissingPackageError(
            f"agent: {file}: a model of Stable-Baselines3 needs wrongturn-sb3; install it with: "
            f"{install('wrongturn-agents[training]')}"
        )
    agent = load(point)(file)
    return _made(agent, partial(copy, agent), [file])


def _check_file(file: Path, wanted: str) -> None:
    if not file.is_file():
        raise ModelFileError(f"agent: {file}: {why_no_file(file)}; name {wanted}")


def _made(agent: Any, make: Callable[[], Agent], files: Iterable[Path]) -> AgentSource:
    """Return the source of what describes itself as an agent does: a loaded model, or a shipped agent."""
    return AgentSource(
        agent.name,
        agent.track,
        agent.kind,
        agent.description,
        make,
        agent.trained_on_faults,
        tuple(files),
        getattr(agent, "rig", None),
    )
