"""Errors of the agents' side. The text of each is one line for a user.

::

    AgentsError
    ├── UnknownAgentError        no agent is registered under the name
    ├── AgentImportError         package.module:Class cannot be imported
    ├── NotAnAgentError          what was imported is not an agent
    ├── AgentFailedError         the agent raised an exception, or returned something other than an action
    ├── ModelFileError           an .onnx file is missing or broken, or breaks the contract
    ├── OnnxRuntimeMissingError  the extra ``onnx`` is not installed
    ├── RunError                 a run cannot begin: its name is taken, its track is not in the suite, ...
    │   └── RunOverError         a run cannot go on: its evaluation is over or deleted, or its token has ended
    ├── RunFileError             the file of a saved run is missing, or cannot be read or written
    └── ResultsError             stored results, or a request about them, are not valid
        └── MissingPackageError  wrongturn-figures, or a package of the extra ``training``, is not installed
"""

from pathlib import Path


class AgentsError(Exception):
    """Base class of the agents' errors. The text is one line for a user."""


def why_no_file(path: Path) -> str:
    """Return what is wrong with a path that leads to no file, for an error."""
    return "is no file" if path.exists() else "there is no such file"


class UnknownAgentError(AgentsError):
    """No agent is registered under the name."""


class AgentImportError(AgentsError):
    """``package.module:Class`` cannot be imported."""


class NotAnAgentError(AgentsError):
    """The imported object lacks ``reset``, ``act`` or ``track``."""


class AgentFailedError(AgentsError):
    """The agent raised an exception (the cause of this one), or returned something other than an action."""


class ModelFileError(AgentsError):
    """An ONNX file is missing or broken, or breaks the contract."""


class OnnxRuntimeMissingError(AgentsError):
    """onnxruntime is not installed."""


class RunError(AgentsError):
    """A run cannot begin with the given options."""


class RunOverError(RunError):
    """A run cannot go on: its evaluation is over or was deleted, or its token has ended."""


class RunFileError(AgentsError):
    """The file of a saved run is missing, or cannot be read or written."""


class ResultsError(AgentsError):
    """Stored results, or a request about them, are not valid."""


class MissingPackageError(ResultsError):
    """wrongturn-figures, or a package of the extra ``training``, is not installed."""
