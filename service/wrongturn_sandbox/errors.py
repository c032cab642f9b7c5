"""Errors of the sandbox. A :class:`SandboxBusyError` is a :class:`SandboxUnavailableError` that does not last."""


class ModelRefusedError(Exception):
    """The model breaks a rule, reached a limit or crashed; the message tells its owner what is wrong and what to do."""


class SandboxLostError(Exception):
    """The sandbox ended without a word, as one does that is killed from outside. The model is not at fault."""


class SandboxUnavailableError(Exception):
    """No sandbox can be opened; the message says why, and what the operator can do."""


class SandboxBusyError(SandboxUnavailableError):
    """All sandboxes of the runner container are taken. One that closes makes room."""
