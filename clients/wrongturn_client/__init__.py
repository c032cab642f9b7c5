"""The light client of Wrongturn: ``Client(url, token).evaluate(policy, suite)``.

Each name is loaded on first use, so that the program ``wrongturn`` starts quickly. Importing this package registers the
Gymnasium environment ``Wrongturn-v0``, single and vectorised.
"""

import sys
from importlib import import_module
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from wrongturn_client.async_client import AsyncClient
    from wrongturn_client.client import Client
    from wrongturn_client.errors import (
        AgentNameTakenError,
        ApiError,
        AuthenticationError,
        ConflictError,
        EpisodeFinishedError,
        EpisodeLostError,
        EvaluationCancelledError,
        EvaluationFinishedError,
        EvaluationStalledError,
        InvalidActionError,
        InvalidRequestError,
        LocalServiceError,
        NotFoundError,
        NotOfferedError,
        NoTrialAvailableError,
        PluginError,
        PolicyError,
        ProtocolError,
        ResultsMismatchError,
        ServiceBusyError,
        ServiceFailedError,
        ServiceFullError,
        ServiceUnreachableError,
        WrongturnError,
    )
    from wrongturn_client.gym_env import RemoteEnv
    from wrongturn_client.local_service import LocalService
    from wrongturn_client.policy import Policy
    from wrongturn_client.vector_env import RemoteVectorEnv
    from wrongturn_protocol import Action

__all__ = [
    "Action",
    "AgentNameTakenError",
    "ApiError",
    "AsyncClient",
    "AuthenticationError",
    "Client",
    "ConflictError",
    "EpisodeFinishedError",
    "EpisodeLostError",
    "EvaluationCancelledError",
    "EvaluationFinishedError",
    "EvaluationStalledError",
    "InvalidActionError",
    "InvalidRequestError",
    "LocalService",
    "LocalServiceError",
    "NoTrialAvailableError",
    "NotFoundError",
    "NotOfferedError",
    "PluginError",
    "Policy",
    "PolicyError",
    "ProtocolError",
    "RemoteEnv",
    "RemoteVectorEnv",
    "ResultsMismatchError",
    "ServiceBusyError",
    "ServiceFailedError",
    "ServiceFullError",
    "ServiceUnreachableError",
    "WrongturnError",
]

_HOMES: Final = {
    "Action": "wrongturn_protocol",
    "AsyncClient": "wrongturn_client.async_client",
    "Client": "wrongturn_client.client",
    "LocalService": "wrongturn_client.local_service",
    "Policy": "wrongturn_client.policy",
    "RemoteEnv": "wrongturn_client.gym_env",
    "RemoteVectorEnv": "wrongturn_client.vector_env",
}


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOMES.get(name, "wrongturn_client.errors")), name)
    globals()[name] = value
    return value


def _register() -> None:
    from gymnasium import register, registry  # noqa: PLC0415 - slow to import, and the program needs it not

    if "Wrongturn-v0" not in registry:
        register(
            "Wrongturn-v0",
            entry_point="wrongturn_client.gym_env:RemoteEnv",
            vector_entry_point="wrongturn_client.vector_env:RemoteVectorEnv",
        )


if PurePath(sys.argv[0] if sys.argv else "").name not in {"wrongturn", "-m"}:
    _register()
