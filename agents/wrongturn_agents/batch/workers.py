"""Workers that drive groups of trials: processes of this machine, or tasks of a Ray cluster."""

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any, Final, Protocol, TypeVar, cast

from wrongturn_agents.errors import RunError
from wrongturn_protocol.installing import NotInstalledError, ray

_Group = TypeVar("_Group")
_Results = TypeVar("_Results")
AHEAD: Final = 1
"""Groups that are handed out beyond those that are driven, so that no worker waits."""


class Workers(Protocol):
    """What drives groups."""

    @property
    def count(self) -> int:
        """Groups that it drives at once, now."""
        ...

    def drive(
        self, groups: Iterator[_Group], drive_group: Callable[[_Group], _Results]
    ) -> Iterator[tuple[_Group, _Results]]:
        """Drive all groups and yield each with its results as it ends.

        After an error, nothing more is begun. What is being driven ends first; then the error is raised.

        Raises what ``drive_group`` raises, a function of a module, and RunError if a worker dies.
        """
        ...


class LocalWorkers:
    """Processes of this machine. They end with this one, even if it is killed."""

    def __init__(self, count: int) -> None:
        self.count = count

    def drive(
        self, groups: Iterator[_Group], drive_group: Callable[[_Group], _Results]
    ) -> Iterator[tuple[_Group, _Results]]:
        """Drive all groups, as :meth:`Workers.drive`."""
        context = multiprocessing.get_context("spawn")  # a fork would share SUMO and threads
        told, stop = context.Pipe(duplex=False)
        pool = ProcessPoolExecutor(self.count, context, _begin, (told,))
        running: dict[Future[_Results], _Group] = {}
        failed: Exception | None = None
        try:
            while True:
                while failed is None and len(running) < self.count + AHEAD and (group := next(groups, None)):
                    running[pool.submit(drive_group, group)] = group
                if not running:
                    break
                for future in wait(running, return_when=FIRST_COMPLETED).done:
                    group = running.pop(future)
                    try:
                        results = future.result()
                    except BrokenProcessPool:
                        failed = RunError("--workers: a worker was killed, perhaps because memory ran out")
                    except Exception as error:  # whatever the agent or the simulation raises
                        failed = failed or error
                    else:
                        yield group, results
        except BaseException:
            stop.close()
            raise
        finally:
            pool.shutdown(cancel_futures=True)
            stop.close()
            told.close()
        if failed is not None:
            raise failed


def _begin(told: Connection) -> None:
    """Prepare a worker: it ends at once if the command says so, is interrupted, or dies."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)

    def end() -> None:
        told.poll(None)  # the other end is closed
        os._exit(1)

    threading.Thread(target=end, name="command", daemon=True).start()


def of_ray(name: str) -> Any:
    """Return what ``--ray`` needs of the package wrongturn-ray. Raises RunError if it is not installed."""
    try:
        return ray(name)
    except NotInstalledError as error:
        raise RunError(f"--ray: {error}") from None


def workers(count: int | None) -> Workers:
    """Return so many processes of this machine; for None, the workers of a Ray cluster."""
    return LocalWorkers(count) if count is not None else cast(Workers, of_ray("workers")())
