"""Workers of batches: tasks of a Ray cluster, each of which drives a group of trials."""

import os
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import ray

from wrongturn_agents.batch.workers import AHEAD
from wrongturn_agents.errors import RunError
from wrongturn_ray.driver import check_answer

_Group = TypeVar("_Group")
_Results = TypeVar("_Results")


class RayWorkers:
    """Tasks of a Ray cluster, each with one processor: the cluster that ``RAY_ADDRESS`` names or that Ray finds.

    Where there is none, Ray starts one of this machine. Ray drives the group of a worker that died again, three times.
    """

    def __init__(self) -> None:
        if not ray.is_initialized():
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
            address = os.environ.get("RAY_ADDRESS", "")
            try:
                check_answer(address)
            except OSError as error:
                raise RunError(f"--ray: RAY_ADDRESS: nobody answers at {address!r}; correct it, or unset it") from error
            try:
                ray.init(include_dashboard=False, logging_level="warning", log_to_driver=False)
            except Exception as error:  # Ray raises many classes, and plain ones if a node starts too slowly
                raise RunError(f"--ray: {_line(error)}; look at RAY_ADDRESS, or unset it") from error

    @property
    def count(self) -> int:
        """Processors of the cluster, now."""
        return max(1, int(ray.cluster_resources().get("CPU", 1)))

    def drive(
        self, groups: Iterator[_Group], drive_group: Callable[[_Group], _Results]
    ) -> Iterator[tuple[_Group, _Results]]:
        """Drive all groups, as :meth:`Workers.drive`. Nodes that join meanwhile are used too."""
        driver = ray.remote(drive_group)
        running: dict[Any, _Group] = {}
        failed: Exception | None = None
        try:
            while True:
                while failed is None and len(running) < self.count + AHEAD and (group := next(groups, None)):
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


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:300]
