"""What can go wrong on the agents' side.

::

    AgentsError
    ├── UnknownAgentError        no agent is registered under the name
    ├── AgentImportError         package.module:Class cannot be imported
    ├── NotAnAgentError          it was imported, and it is no agent
    ├── AgentFailedError         it raised something while it was made or drove, or gave no action
    ├── ModelFileError           an .onnx file is missing, broken or has other inputs and outputs
    ├── OnnxRuntimeMissingError  the extra ``onnx`` is not installed
    ├── RunError                 a run cannot begin: its name is taken, its track is not in the suite, ...
    └── RunFileError             a run cannot be resumed: its file is missing or not readable
"""


class AgentsError(Exception):
    """Root of the agents' errors; the text is one line for a user."""


class UnknownAgentError(AgentsError):
    """No agent is registered under the name."""


class AgentImportError(AgentsError):
    """``package.module:Class`` cannot be imported."""


class NotAnAgentError(AgentsError):
    """What was imported lacks ``reset``, ``act`` or ``track``."""


class AgentFailedError(AgentsError):
    """An agent raised something while it was made or drove (the cause says what), or gave no action."""


class ModelFileError(AgentsError):
    """An ONNX file is missing, broken or does not keep to the contract."""


class OnnxRuntimeMissingError(AgentsError):
    """onnxruntime is not installed."""


class RunError(AgentsError):
    """A run cannot begin as it was asked for."""


class RunFileError(AgentsError):
    """A run cannot be resumed from what was named."""
