"""The errors of this client for the problems that the service reports."""

from typing import Final

from pydantic import ValidationError

from wrongturn_client.errors import (
    AgentNameTakenError,
    ApiError,
    AuthenticationError,
    ConflictError,
    EpisodeFinishedError,
    EpisodeLostError,
    EvaluationCancelledError,
    EvaluationFinishedError,
    EvaluationOpenError,
    InvalidRequestError,
    NotFoundError,
    NoTrialAvailableError,
    OwnerNameTakenError,
    QuotaReachedError,
    ResultsMismatchError,
    ServiceBusyError,
    ServiceFailedError,
    SubmissionsUnavailableError,
)
from wrongturn_protocol import Problem, ProblemType

_BY_TYPE: Final[dict[str, type[ApiError]]] = {
    ProblemType.UNAUTHENTICATED: AuthenticationError,
    ProblemType.FORBIDDEN: AuthenticationError,
    ProblemType.REGISTRATION_CLOSED: AuthenticationError,
    ProblemType.FAULT_NOT_APPLICABLE: InvalidRequestError,
    ProblemType.TRACK_NOT_AVAILABLE: InvalidRequestError,
    ProblemType.AGENT_NAME_TAKEN: AgentNameTakenError,
    ProblemType.OWNER_NAME_TAKEN: OwnerNameTakenError,
    ProblemType.EVALUATION_OPEN: EvaluationOpenError,
    ProblemType.EVALUATION_FINISHED: EvaluationFinishedError,
    ProblemType.EVALUATION_CANCELLED: EvaluationCancelledError,
    ProblemType.NO_TRIAL_AVAILABLE: NoTrialAvailableError,
    ProblemType.EPISODE_FINISHED: EpisodeFinishedError,
    ProblemType.RESULTS_MISMATCH: ResultsMismatchError,
    ProblemType.EPISODE_LOST: EpisodeLostError,
    ProblemType.SUBMISSIONS_UNAVAILABLE: SubmissionsUnavailableError,
    ProblemType.QUOTA_REACHED: QuotaReachedError,
    ProblemType.RATE_LIMITED: ServiceBusyError,
    ProblemType.SIMULATORS_BUSY: ServiceBusyError,
    ProblemType.SHUTTING_DOWN: ServiceBusyError,
}
_BY_STATUS: Final[dict[int, type[ApiError]]] = {
    401: AuthenticationError,
    403: AuthenticationError,
    404: NotFoundError,
    409: ConflictError,
    429: ServiceBusyError,
    502: ServiceBusyError,
    503: ServiceBusyError,
    504: ServiceBusyError,
}


def api_error(problem: Problem, retry_after: float | None = None) -> ApiError:
    """Return the error for a problem, by its type or else by its status."""
    kind = _BY_TYPE.get(problem.type.rsplit("/", 1)[-1]) or _BY_STATUS.get(problem.status)
    if kind is None:
        kind = ServiceFailedError if problem.status >= 500 else InvalidRequestError
    return kind(problem, retry_after)


def own_problem(body: bytes) -> bool:
    """Tell whether a body is a problem of a Wrongturn service, rather than of a proxy before it."""
    try:
        return Problem.model_validate_json(body).type.rsplit("/", 1)[-1] in set(ProblemType)
    except ValidationError:
        return False
