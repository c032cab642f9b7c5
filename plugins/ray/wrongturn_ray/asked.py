"""What a node is asked before it drives models: ``python -m wrongturn_ray.asked URL SOCKET [gpu]``.

It opens a sandbox, as a runner does, and calls the service. It prints what the sandbox is, or ends with a status that
is not 0 and says what is missing. ``SOCKET`` is that of a runner container, or empty. An empty ``URL`` is not called.
"""

import sys
from pathlib import Path
from typing import Final
from urllib.request import ProxyHandler, build_opener

from wrongturn_sandbox import SandboxUnavailableError, probe

_PATIENCE_S: Final = 10.0


def main() -> None:
    """Answer."""
    url, path, *gpu = sys.argv[1:]
    try:
        found = probe(Path(path) if path else None, gpu=bool(gpu))
    except SandboxUnavailableError as error:
        sys.exit(str(error))
    try:
        if url:
            build_opener(ProxyHandler({})).open(f"{url}/health/live", timeout=_PATIENCE_S).close()
    except OSError as error:
        reason = getattr(error, "reason", error)
        sys.exit(
            f"it cannot reach the service at {url} ({reason}); set WRONGTURN_HOST to an address that nodes reach, or "
            "WRONGTURN_RUNNER_URL"
        )
    print(found)


if __name__ == "__main__":
    main()
