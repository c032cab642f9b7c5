"""Workers that drive groups of trials: processes of this machine, or tasks of a Ray cluster."""

import multiprocessing
import os
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from typing import Any, Final, Protocol, TypeVar

from wrongturn_agents.errors import RunError
from wrongturn_protocol.installing import install

_Group = TypeVar("_Group")
_Results = TypeVar("_Results")
_ANSWER_S: Final = 5.0
"""Seconds within which a cluster has to answer."""
_AHEAD: Final = 1
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
                while failed is None and len(running) < self.count + _AHEAD and (group := next(groups, None)):
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


class RayWorkers:
    """Tasks of a Ray cluster, each with one processor: the cluster that ``RAY_ADDRESS`` names or that Ray finds.

    Where there is none, Ray starts one of this machine. Ray drives the group of a worker that died again, three times.
    """

    def __init__(self) -> None:
        self._ray = load_ray()
        if not self._ray.is_initialized():
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
            address = os.environ.get("RAY_ADDRESS", "")
            try:
                check_answer(address)
            except OSError as error:
                raise RunError(f"--ray: RAY_ADDRESS: nobody answers at {address!r}; correct it, or unset it") from error
            try:
                self._ray.init(include_dashboard=False, logging_level="warning", log_to_driver=False)
            except Exception as error:  # Ray raises many classes, and plain ones if a node starts too slowly
                raise RunError(f"--ray: {_line(error)}; look at RAY_ADDRESS, or unset it") from error

    @property
    def count(self) -> int:
        """Processors of the cluster, now."""
        return max(1, int(self._ray.cluster_resources().get("CPU", 1)))

    def drive(
        self, groups: Iterator[_Group], drive_group: Callable[[_Group], _Results]
    ) -> Iterator[tuple[_Group, _Results]]:
        """Drive all groups, as :meth:`Workers.drive`. Nodes that join meanwhile are used too."""
        ray, driver = self._ray, self._ray.remote(drive_group)
        running: dict[Any, _Group] = {}
        failed: Exception | None = None
        try:
            while True:
                while failed is None and len(running) < self.count + _AHEAD and (group := next(groups, None)):
                    running[driver.remote(group)] = group
                if not running:
                    break
                for task in ray.wait([*running], num_returns=1)[0]:
                    group = running.pop(task)
                    try:
                        results = ray.get(task)
                    except ray.exceptions.RayTaskError as error:
                        failed = failed or error.cause
                    except ray.exceptions.RayError as error:
                        failed = failed or RunError(f"--ray: a group's workers died: {_line(error)}")
                    else:
                        yield group, results
        finally:
            for task in running:
                ray.cancel(task, force=True)
        if failed is not None:
            raise failed


def check_answer(address: str) -> None:
    """Check that somebody listens at an address with a port: Ray itself tries for minutes. Raises OSError."""
    host, _, port = address.rpartition(":")
    if port.isdecimal():
        try:
            socket.create_connection((host, int(port)), _ANSWER_S).close()
        except OverflowError as error:
            raise OSError(str(error)) from error


def load_ray() -> Any:
    """Import and return Ray. Raises RunError, which names the extra, if it is not installed."""
    try:
        import ray  # noqa: PLC0415 - comes with an extra, and only --ray needs it
    except ImportError:
        raise RunError(f"--ray: Ray is not installed; install it with: {install('wrongturn-agents[ray]')}") from None
    return ray


def workers(count: int | None) -> Workers:
    """Return so many processes of this machine; for None, the workers of a Ray cluster."""
    return RayWorkers() if count is None else LocalWorkers(count)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:300]
