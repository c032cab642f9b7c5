"""Refuse the use of an environment or a connection by two threads at a time.

Of a connection, one would take the other's replies, and both would wait. Of an environment, both would drive the same
step.
"""

import threading

from wrongturn_client.errors import WrongturnError


class OneThread:
    """Context in which one thread uses an environment or a connection. The same thread may enter it again.

    Raises:
        WrongturnError: Another thread is inside.
    """

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def __enter__(self) -> None:
        if not self._lock.acquire(blocking=False):
            raise WrongturnError(
                "an environment or connection is used by two threads at a time; make one for each thread, or take turns"
            )

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type["OneThread"], tuple[()]]:
        """Pickle what holds this: in another process nobody is inside."""
        return OneThread, ()
