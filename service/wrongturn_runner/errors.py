"""How a runner ends before its work is done.

These are no ``Exception``: the client aborts the episode of a policy that raises one, and an aborted episode counts.
The service decides what becomes of open episodes. It closes the evaluation of a refused model, and drives again what
a lost sandbox left open.
"""


class ModelAtFaultError(BaseException):
    """The model cannot be driven. The message tells its owner what is wrong and what to do."""


class RunnerFailedError(BaseException):
    """Something else than the model has failed. The service starts another runner."""


class NoRoomError(RunnerFailedError):
    """All sandboxes are taken. The service starts another runner later."""
