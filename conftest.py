"""What all tests share: their order, who runs them, their examples, and what services and clients need not do."""

import asyncio
import functools
import gc
import inspect
import os
from collections.abc import Generator, Iterator
from pathlib import Path
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

_OF_ONE_SERVICE = (
    "agents",
    "bad_input",
    "drive",
    "drive_frames",
    "drive_refusals",
    "episodes",
    "evaluations",
    "owners",
)
# torch's exporter takes 5 s to load, once for each worker.
_EXPORTS = ("test_export", *(f"training/test_{name}" for name in ("doubting",)))
TOGETHER = {
    "tests/client": "clients",
    "tests/environments": "clients",
    "tests/idioms": "clients",
    "tests/runner": "clients",
    **{f"tests/service/test_{name}.py": "service" for name in (*_OF_ONE_SERVICE, "replays", "traffic", "views")},
    "tests/contract": "contract",
    "tests/browser": "browser",
    "plugins/exploits": "agents",
    "plugins/certificates": "service",
    "plugins/figures": "agents",
    "plugins/lbc": "exports",
    "plugins/marln": "exports",
    "plugins/statistics": "agents",
    **{f"tests/agents/test_{name}.py": "agents" for name in ("batch", "practice", "worker")},
    "tests/benchmarks/test_short_forms.py": "agents",
    **{f"tests/system/test_{name}.py": "agents" for name in ("mistakes", "pages_run")},
    **{f"tests/agents/{name}.py": "exports" for name in _EXPORTS},
    "tests/extending": "exports",
    "plugins/sb3": "exports",
}
"""Folders and files that share a service which takes long to start or to fill, or a large import: one worker runs
all of a group. The longest group comes first."""


SLOW = frozenset((Path(__file__).parent / "tests/slow.txt").read_text("utf-8").splitlines())
"""The tests that CI leaves out: whole tests, or single cases of them. CONTRIBUTING.md has the rule."""


def group_of(nodeid: str) -> str | None:
    """The group of a test, None without one."""
    file = nodeid.split("::", 1)[0]
    return next((group for place, group in TOGETHER.items() if file == place or file.startswith(f"{place}/")), None)


class FolderScheduling(LoadFileScheduling):  # type: ignore[misc]
    """Give whole files to the workers, and whole groups where :data:`TOGETHER` names them."""

    def _split_scope(self, nodeid: str) -> str:
        return group_of(nodeid) or nodeid.split("::", 1)[0]


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
    """Mark the slow tests. Put groups first, then the files of slow tests: no worker ends alone with a long one."""
    slow = set()
    for item in items:
        if not SLOW.isdisjoint({item.nodeid, item.nodeid.split("[")[0]}):
            item.add_marker("slow")
            slow.add(item.path)
    groups = list(dict.fromkeys(TOGETHER.values()))

    def turn(item: pytest.Item) -> int:
        group = group_of(item.nodeid)
        return len(groups) + (item.path not in slow) if group is None else groups.index(group)

    items.sort(key=turn)


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine in an event loop of its own."""
    if not inspect.iscoroutinefunction(pyfuncitem.obj):
        return None
    names = inspect.signature(pyfuncitem.obj).parameters
    asyncio.run(pyfuncitem.obj(**{name: pyfuncitem.funcargs[name] for name in names}))
    return True


@pytest.fixture(scope="module")
def one_thread() -> Iterator[None]:
    """Small batches are slower with threads that wait for each other."""
    torch = pytest.importorskip("torch")
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalService]:
    """One real service for all tests that change nothing of it that another test looks at; a start costs 6 s."""
    database = tmp_path_factory.mktemp("service") / "wrongturn.db"
    settings = {
        "WRONGTURN_OPERATOR_TOKEN": "operator-token-of-the-tests-0123456789",
        "WRONGTURN_REGISTRATION_LIMIT": "1000",
        "WRONGTURN_SUBMISSIONS": "0",
        "WRONGTURN_SIMULATORS": "4",
    }
    with LocalService(database=f"sqlite+aiosqlite:///{database}", environment=settings) as service:
        yield service


@pytest.fixture(scope="session")
def bubblewrap() -> None:
    """Bubblewrap works here, or the test is skipped."""
    try:
        probe(None)
    except SandboxUnavailableError as error:
        pytest.skip(str(error))
