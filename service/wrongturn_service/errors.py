"""Errors of the service; :mod:`wrongturn_service.api.errors` turns each into ``application/problem+json``."""

from collections.abc import Mapping, Sequence

from wrongturn_protocol import FieldError, Problem, ProblemType
from wrongturn_protocol.vocabulary import Collection


class StartupError(Exception):
    """The service cannot start. The message says why and what to do."""


class ServiceError(Exception):
    """A call is refused with a problem of the closed list."""

    status = 500

    def __init__(
        self,
        kind: ProblemType,
        detail: str,
        *,
        status: int | None = None,
        errors: Sequence[FieldError] = (),
        headers: Mapping[str, str] | None = None,
        position: int | None = None,
    ) -> None:
        super().__init__(detail)
        self.kind = kind
        self.detail = detail
        self.status = self.status if status is None else status
        self.errors = tuple(errors)
        self.headers = dict(headers or {})
        self.position = position

    def problem(self) -> Problem:
        """Return the problem as a message."""
        return Problem(
            type=f"/problems/{self.kind}",
            title=title(self.kind),
            status=self.status,
            detail=self.detail,
            errors=self.errors,
            position=self.position,
        )


class InvalidRequestError(ServiceError):
    """A field is wrong. The path names it."""

    status = 422

    def __init__(self, path: str, message: str, kind: ProblemType = ProblemType.VALIDATION) -> None:
        detail = message if message.startswith(path) else f"{path}: {message}"
        super().__init__(kind, detail, errors=(FieldError(path=path, message=message),))


class UnauthenticatedError(ServiceError):
    """The call has no token, or one that the service does not know."""

    status = 401

    def __init__(self, detail: str) -> None:
        super().__init__(ProblemType.UNAUTHENTICATED, detail, headers={"WWW-Authenticate": 'Bearer realm="wrongturn"'})


class ForbiddenError(ServiceError):
    """The token is valid but does not allow this call."""

    status = 403

    def __init__(self, detail: str, kind: ProblemType = ProblemType.FORBIDDEN) -> None:
        super().__init__(kind, detail)


class NotFoundError(ServiceError):
    """Nothing has this name or id."""

    status = 404


class ConflictError(ServiceError):
    """The call does not fit the current state."""

    status = 409


class GoneError(ServiceError):
    """The episode is lost. It does not count."""

    status = 410

    def __init__(self, detail: str) -> None:
        super().__init__(ProblemType.EPISODE_LOST, detail)


class QuotaReachedError(ServiceError):
    """The owner, or the address that registered it, has as much as it may have. Waiting does not help."""

    status = 507

    def __init__(self, detail: str) -> None:
        super().__init__(ProblemType.QUOTA_REACHED, detail)


class UnavailableError(ServiceError):
    """The call cannot be served now. ``Retry-After`` says when to send it again.

    ``position`` says how many simulators have to become free first, or how many of the agent's own episodes,
    evaluations or connections have to end first.
    """

    status = 503

    def __init__(
        self, kind: ProblemType, detail: str, *, retry_after_s: int = 1, status: int = 503, position: int | None = None
    ) -> None:
        super().__init__(kind, detail, status=status, headers={"Retry-After": str(retry_after_s)}, position=position)


def too_many(detail: str, *, retry_after_s: int = 5) -> UnavailableError:
    """Return the error for a caller that has as many at a time as it may have."""
    return UnavailableError(ProblemType.RATE_LIMITED, detail, retry_after_s=retry_after_s, status=429, position=1)


def title(kind: ProblemType) -> str:
    """Return a problem type's title."""
    return kind.value.replace("-", " ").capitalize()


def unknown(collection: Collection, item_id: str) -> NotFoundError:
    """Return the error for an item that does not exist, or that is hidden from the caller."""
    return NotFoundError(ProblemType(f"unknown-{collection.one}"), f"there is no {collection.one} {item_id[:64]!r}")
