"""The light client of Wrongturn: ``Client(url, token).evaluate(policy, suite)``.

``__init__.pyi`` lists the public names. Each is loaded on first use, so that the program ``wrongturn`` starts quickly.
Importing this package registers the Gymnasium environment ``Wrongturn-v0``, single and vectorised.
"""

import sys
from pathlib import PurePath

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def _register() -> None:
    from gymnasium import register, registry  # noqa: PLC0415 - slow to import, and the program does not need it

    from wrongturn_protocol.variants import register_variants  # noqa: PLC0415

    if "Wrongturn-v0" not in registry:
        register(
            "Wrongturn-v0",
            entry_point="wrongturn_client.gym_env:RemoteEnv",
            vector_entry_point="wrongturn_client.vector_env:RemoteVectorEnv",
        )
        register_variants("Wrongturn", "wrongturn_client.gym_env:RemoteEnv")


if PurePath(sys.argv[0] if sys.argv else "").name not in {"wrongturn", "-m"}:
    _register()
