"""Errors of the sandbox.

::

    SandboxError
    ├── ModelRefusedError        the model is at fault
    ├── SandboxLostError         the sandbox was ended from outside: try again
    └── SandboxUnavailableError  no sandbox can be opened here
        └── SandboxBusyError     not now: try again later
"""


class SandboxError(Exception):
    """Base of the errors below."""


class ModelRefusedError(SandboxError):
    """The model breaks a rule, reached a limit or crashed; the message is for its owner."""

    @property
    def reason(self) -> str:
        """What is wrong and what to do."""
        return str(self)


class SandboxLostError(SandboxError):
    """The sandbox ended without a word, as one does that is killed from outside. The model is not at fault."""


class SandboxUnavailableError(SandboxError):
    """No sandbox can be opened; the message says why, and what the operator can do."""


class SandboxBusyError(SandboxUnavailableError):
    """All sandboxes of the runner container are taken. One that closes makes room."""
