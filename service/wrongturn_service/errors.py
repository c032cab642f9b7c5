"""What the service refuses, and as what.

::

    StartupError                  the service cannot start; the message says why and what to do
    ServiceError                  one problem of the closed list (RFC 9457): type, status, detail, errors, headers
    ├── InvalidRequestError       422 validation, with the fields' paths
    ├── UnauthenticatedError      401, with ``WWW-Authenticate``
    ├── ForbiddenError            403
    ├── NotFoundError             404, the type names what is unknown
    ├── ConflictError             409
    ├── GoneError                 410 episode-lost
    └── UnavailableError          429 or 503, with ``Retry-After``

Every one of them becomes ``application/problem+json`` in :mod:`wrongturn_service.api.errors`, the one handler.
"""

from collections.abc import Mapping, Sequence

from wrongturn_protocol import FieldError, Problem, ProblemType


class StartupError(Exception):
    """The service cannot start; the message says why and what to do."""


class ServiceError(Exception):
    """A call is refused by one problem of the closed list."""

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
        """The message for the wire."""
        return Problem(
            type=f"/problems/{self.kind}",
            title=title(self.kind),
            status=self.status,
            detail=self.detail,
            errors=self.errors,
            position=self.position,
        )


class InvalidRequestError(ServiceError):
    """A field is wrong; the path says which."""

    status = 422

    def __init__(self, path: str, message: str, kind: ProblemType = ProblemType.VALIDATION) -> None:
        super().__init__(kind, f"{path}: {message}", errors=(FieldError(path=path, message=message),))


class UnauthenticatedError(ServiceError):
    """No token, or none that the service knows."""

    status = 401

    def __init__(self, detail: str) -> None:
        super().__init__(ProblemType.UNAUTHENTICATED, detail, headers={"WWW-Authenticate": 'Bearer realm="wrongturn"'})


class ForbiddenError(ServiceError):
    """The token is good, but another's."""

    status = 403

    def __init__(self, detail: str, kind: ProblemType = ProblemType.FORBIDDEN) -> None:
        super().__init__(kind, detail)


class NotFoundError(ServiceError):
    """Nothing has this name."""

    status = 404


class ConflictError(ServiceError):
    """The call does not fit what was said before."""

    status = 409


class GoneError(ServiceError):
    """The episode is lost; nobody is charged for it."""

    status = 410

    def __init__(self, detail: str) -> None:
        super().__init__(ProblemType.EPISODE_LOST, detail)


class UnavailableError(ServiceError):
    """Not now; ``Retry-After`` says when to come back.

    The position says how many places have to become free until it is this call's turn: simulators' where it stands in
    the line for one, one's own where a limit of one's own is met.
    """

    status = 503

    def __init__(
        self,
        kind: ProblemType,
        detail: str,
        *,
        retry_after_s: int = 1,
        status: int = 503,
        position: int | None = None,
    ) -> None:
        super().__init__(kind, detail, status=status, headers={"Retry-After": str(retry_after_s)}, position=position)


def title(kind: ProblemType) -> str:
    """A short name of a problem's type for people."""
    return kind.value.replace("-", " ").capitalize()
