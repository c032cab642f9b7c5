"""The exceptions of the client; each class says when it is raised."""

from typing import TYPE_CHECKING, Final

from wrongturn_protocol.vocabulary import ProblemType

if TYPE_CHECKING:  # pydantic is slow to import, and the program needs its errors first
    from wrongturn_protocol import Problem

_BY_TYPE: Final[dict[str, "type[ApiError]"]] = {}
"""The errors for single types of problems; for others the status decides."""


class WrongturnError(Exception):
    """Base of all exceptions of the client."""


class ServiceUnreachableError(WrongturnError):
    """Nobody answers at the URL."""

    def __init__(self, url: str, reason: str) -> None:
        super().__init__(
            f"no Wrongturn service answers at {url} ({reason}); start one by 'wrongturn serve', "
            "or name another by --url or WRONGTURN_URL"
        )
        self.url = url
        self.reason = reason


class ProtocolError(WrongturnError):
    """This client does not understand the answer: another program or version is at the URL."""


class NotOfferedError(WrongturnError):
    """The service, or a proxy before it, has no WebSocket for driving, or it speaks another version."""


class LocalServiceError(WrongturnError):
    """A service of your own did not start."""


class EvaluationStalledError(WrongturnError):
    """The service handed out no trial for too long, although the evaluation is not finished."""


class SecretFileError(WrongturnError):
    """The file that a variable such as ``WRONGTURN_TOKEN_FILE`` names cannot be read, or is empty."""


class NotFinishedError(WrongturnError):
    """An evaluation is not finished yet, or was cancelled, so it has no run file."""


class CommitmentError(WrongturnError):
    """The trials cannot be trusted: the secret told at the end does not have the SHA-256 told at the beginning."""


class PolicyError(WrongturnError):
    """The policy returned something that is not an action."""


class InvalidActionError(WrongturnError, ValueError):
    """An action is not three numbers in their ranges; the message names the field."""


class ModelFileError(WrongturnError):
    """A model's file cannot be read, or it is no ONNX file. The message says what to do."""


class ServiceFullError(WrongturnError):
    """The service has fewer free simulators than environments were asked for."""


class ReplayError(WrongturnError):
    """There is nothing to replay, or nothing here that draws it. The message says what to do."""


class PluginError(WrongturnError):
    """A command, list or check of another package cannot be loaded."""


class ApiError(WrongturnError):
    """The service refused a call."""

    def __init_subclass__(cls, types: tuple[ProblemType, ...] = ()) -> None:
        _BY_TYPE.update(dict.fromkeys(types, cls))

    def __init__(self, problem: "Problem", retry_after: float | None = None) -> None:
        said = problem.detail or problem.title
        fields = "; ".join(f"{error.path}: {error.message}" for error in problem.errors if error.message not in said)
        super().__init__(f"{said} ({fields})" if fields else said)
        self.problem = problem
        """The service's error reply."""
        self.retry_after = retry_after
        """Seconds after which the service asks to be called again; None if it does not say."""

    @property
    def type(self) -> str:
        """One of :class:`wrongturn_protocol.ProblemType`; ``blank`` if another program answered."""
        return self.problem.type.rsplit("/", 1)[-1].removeprefix("about:")

    @property
    def status(self) -> int:
        """The HTTP status."""
        return self.problem.status


class AuthenticationError(
    ApiError, types=(ProblemType.UNAUTHENTICATED, ProblemType.FORBIDDEN, ProblemType.REGISTRATION_CLOSED)
):
    """No token, somebody else's token, or registration is closed."""


class InvalidRequestError(ApiError, types=(ProblemType.FAULT_NOT_APPLICABLE, ProblemType.TRACK_NOT_AVAILABLE)):
    """A field is wrong, or does not apply."""


class NotFoundError(ApiError):
    """An unknown suite, town, approach, trial, owner, agent, evaluation, episode or submission."""


class ConflictError(ApiError):
    """The call does not fit earlier calls."""


class AgentNameTakenError(ConflictError, types=(ProblemType.AGENT_NAME_TAKEN,)):
    """Another agent has the name."""


class OwnerNameTakenError(ConflictError, types=(ProblemType.OWNER_NAME_TAKEN,)):
    """Another owner has the name."""


class EvaluationOpenError(ConflictError, types=(ProblemType.EVALUATION_OPEN,)):
    """The agent has an evaluation on the suite that is not finished."""

    @property
    def evaluation(self) -> str:
        """Id of the open evaluation; empty if the service does not say."""
        return next((error.message for error in self.problem.errors if error.path == "evaluation"), "")


class EvaluationFinishedError(ConflictError, types=(ProblemType.EVALUATION_FINISHED,)):
    """No trial is left."""


class EvaluationCancelledError(ConflictError, types=(ProblemType.EVALUATION_CANCELLED,)):
    """The evaluation was cancelled."""


class NoTrialAvailableError(ConflictError, types=(ProblemType.NO_TRIAL_AVAILABLE,)):
    """No trial is free now: the first half has not ended yet, or the limit of open episodes is reached."""


class EpisodeFinishedError(ConflictError, types=(ProblemType.EPISODE_FINISHED,)):
    """The episode is over."""


class ResultsMismatchError(ConflictError, types=(ProblemType.RESULTS_MISMATCH,)):
    """The worker's own record differs from what the service saw."""


class EpisodeLostError(ApiError, types=(ProblemType.EPISODE_LOST,)):
    """The service was restarted while the episode was open; its trial is driven again, and nothing is counted."""


class SubmissionsUnavailableError(ApiError, types=(ProblemType.SUBMISSIONS_UNAVAILABLE,)):
    """The service takes no submissions: it has no sandbox, or its operator turned them off. The message says which."""


class ServiceBusyError(
    ApiError, types=(ProblemType.RATE_LIMITED, ProblemType.SIMULATORS_BUSY, ProblemType.SHUTTING_DOWN)
):
    """The service asks to be called again later; the client does so for a while before it raises this."""


class TownsNotBuiltError(ServiceBusyError, types=(ProblemType.TOWNS_NOT_BUILT,)):
    """The service still builds the towns of the evaluation, or cannot build them: the message says which."""


class QuotaReachedError(ApiError, types=(ProblemType.QUOTA_REACHED,)):
    """You, or the address that registered you, have as much stored as may be. The message says what helps."""


class ServiceFailedError(ApiError):
    """The service failed."""


def api_error(problem: "Problem", retry_after: float | None = None) -> ApiError:
    """Return the error for a problem, by its type or else by its status."""
    status = problem.status
    by_status = {401: AuthenticationError, 403: AuthenticationError, 404: NotFoundError, 409: ConflictError}
    by_status |= dict.fromkeys((429, 502, 503, 504), ServiceBusyError)
    other = ServiceFailedError if status >= 500 else InvalidRequestError
    kind = _BY_TYPE.get(problem.type.rsplit("/", 1)[-1]) or by_status.get(status, other)
    return kind(problem, retry_after)
