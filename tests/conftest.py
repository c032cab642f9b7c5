"""What all tests share: their order, who runs them, their examples, and what services and clients need not do."""

import functools
import gc
import os
from collections.abc import Generator, Iterator
from typing import Any

import httpx._transports.default
import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers
from xdist.scheduler import LoadFileScheduling

from wrongturn_client import LocalService
from wrongturn_sandbox import SandboxUnavailableError, probe

# Each new client of httpx loads all certificates anew, which takes 30 ms. The tests make thousands and need none.
httpx._transports.default.create_ssl_context = functools.cache(httpx._transports.default.create_ssl_context)

# By default, Python looks for garbage after 700 new objects. That took 6 to 11 % of the time of the measured tests.
gc.set_threshold(20_000)

# A spare simulator takes a core for two seconds. Tests that are about it ask for one.
os.environ.setdefault("WRONGTURN_SPARE_SIMULATORS", "0")

# Examples take what time they take on a busy machine, and each run has the same ones. Hypothesis would also take
# constants from the source of what is loaded, which differs from worker to worker.
_NO_CONSTANTS = providers._local_constants
providers._get_local_constants = lambda: _NO_CONSTANTS
settings.register_profile(
    "same", deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("same")

TOGETHER = {
    "tests/browser": "browser",
    "tests/client": "clients",
    "tests/contract": "contract",
    "tests/environments": "clients",
    "tests/exploits": "exploits",
    "tests/idioms": "clients",
    "tests/runner": "clients",
}
"""Folders whose files share a service that takes long to start or to fill: one worker runs all of a group."""


class FolderScheduling(LoadFileScheduling):  # type: ignore[misc]
    """Give whole files to the workers, and whole folders where :data:`TOGETHER` names them."""

    def _split_scope(self, nodeid: str) -> str:
        file = nodeid.split("::", 1)[0]
        return next((group for folder, group in TOGETHER.items() if file.startswith(f"{folder}/")), file)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> FolderScheduling | None:
    return FolderScheduling(config, log) if config.getvalue("dist") == "loadfile" else None


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Import the tests without garbage collections, and leave what they imported out of later ones.

    These objects stay until the end. To look through them again and again takes a fifth of the collection's time.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files with slow tests, and whole folders, first: no worker is left alone with a long one at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow and not item.nodeid.startswith(tuple(TOGETHER)))


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalService]:
    """One real service for all tests that change nothing of it that another test looks at; a start costs 6 s."""
    database = tmp_path_factory.mktemp("service") / "wrongturn.db"
    settings = {"WRONGTURN_SUBMISSIONS": "0", "WRONGTURN_SIMULATORS": "4"}
    with LocalService(database=f"sqlite+aiosqlite:///{database}", environment=settings) as service:
        yield service


@pytest.fixture(scope="session")
def bubblewrap() -> None:
    """Bubblewrap works here, or the test is skipped."""
    try:
        probe(None)
    except SandboxUnavailableError as error:
        pytest.skip(str(error))
