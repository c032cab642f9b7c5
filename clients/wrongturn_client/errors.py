"""What can go wrong for a user of the client.

::

    WrongturnError
    ├── ServiceUnreachableError      nobody answers at the URL
    ├── ProtocolError                the answer is none that this client understands
    ├── NotOfferedError              there is no WebSocket at the URL; HTTP does the same
    ├── LocalServiceError            ``wrongturn serve`` did not come up
    ├── EvaluationStalledError       no trial was handed out for too long
    ├── PolicyError                  the policy gave something that is no action
    ├── InvalidActionError           an action of the Gymnasium environment is none (also a ValueError)
    ├── ServiceFullError             more environments were asked for than the service has simulators free
    ├── PluginError                  another part's command, list or check cannot be loaded
    └── ApiError                     the service says no, by a problem of RFC 9457
        ├── AuthenticationError      no token, another's token, registration closed
        ├── InvalidRequestError      a field is wrong or does not apply
        ├── NotFoundError            unknown suite, town, approach, trial, agent, evaluation or episode
        ├── ConflictError            the call does not fit what was said before
        │   ├── AgentNameTakenError
        │   ├── EvaluationFinishedError
        │   ├── EvaluationCancelledError
        │   ├── NoTrialAvailableError
        │   ├── EpisodeFinishedError
        │   └── ResultsMismatchError
        ├── EpisodeLostError         the service was started again while the episode was open
        ├── ServiceBusyError         come back later: rate limit, simulators busy, shutting down, a gateway's 502 to 504
        └── ServiceFailedError       the service broke: 5xx
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the program wants its errors before it wants pydantic
    from wrongturn_protocol import Problem


class WrongturnError(Exception):
    """The root of all that the client raises on purpose."""


class ServiceUnreachableError(WrongturnError):
    """Nobody answers at the URL."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(
            f"no Wrongturn service answers at {url} ({reason}); start one by 'wrongturn serve', "
            "or name another by --url or WRONGTURN_URL",
        )
        self.url = url
        self.reason = reason


class ProtocolError(WrongturnError):
    """The answer is none that this client understands: another program, or another version, is at the URL."""


class NotOfferedError(WrongturnError):
    """The service, or what lies before it, has no WebSocket for driving, or speaks another version of its protocol."""


class LocalServiceError(WrongturnError):
    """A service of one's own did not come up."""


class EvaluationStalledError(WrongturnError):
    """The service handed out no trial for too long, though the evaluation is not finished."""


class PolicyError(WrongturnError):
    """The policy gave something that is no action."""


class InvalidActionError(WrongturnError, ValueError):
    """An action given to the Gymnasium environment is none, or out of range."""


class ServiceFullError(WrongturnError):
    """More environments were asked for than the service has simulators free."""


class PluginError(WrongturnError):
    """A command, list or check that another part adds cannot be loaded."""


class ApiError(WrongturnError):
    """The service refused a call."""

    def __init__(self, problem: "Problem", retry_after: float | None = None) -> None:
        said = problem.detail or problem.title
        fields = "; ".join(f"{error.path}: {error.message}" for error in problem.errors if error.message not in said)
        super().__init__(f"{said} ({fields})" if fields else said)
        self.problem = problem
        """What the service sent."""
        self.retry_after = retry_after
        """Seconds after which the service asks to be called again; None where it said nothing."""

    @property
    def type(self) -> str:
        """The problem's kind, one of :class:`wrongturn_protocol.ProblemType`; ``blank`` from another program."""
        return self.problem.type.rsplit("/", 1)[-1].removeprefix("about:")

    @property
    def status(self) -> int:
        """The HTTP status."""
        return self.problem.status


class AuthenticationError(ApiError):
    """No token, another's token, or registration is closed."""


class InvalidRequestError(ApiError):
    """A field is wrong, or does not apply here."""


class NotFoundError(ApiError):
    """An unknown suite, town, approach, trial, agent, evaluation or episode."""


class ConflictError(ApiError):
    """The call does not fit what was said before."""


class AgentNameTakenError(ConflictError):
    """Another agent has the name."""


class EvaluationFinishedError(ConflictError):
    """No trial is left."""


class EvaluationCancelledError(ConflictError):
    """The evaluation was cancelled."""


class NoTrialAvailableError(ConflictError):
    """For now only the twin of an open trial is left, or as many are open as may be."""


class EpisodeFinishedError(ConflictError):
    """The episode has had its last step."""


class ResultsMismatchError(ConflictError):
    """The worker's own record differs from what the service saw."""


class EpisodeLostError(ApiError):
    """The service was started again while the episode was open; its trial runs anew and nobody is charged."""


class ServiceBusyError(ApiError):
    """The service asks to be called again later; the client does so by itself for a while."""


class ServiceFailedError(ApiError):
    """The service broke."""
