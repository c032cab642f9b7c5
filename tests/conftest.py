"""What all tests share: the order in which they run, and certificates that are loaded once."""

import functools

import httpx._transports.default
import pytest

from wrongturn_sandbox import SandboxUnavailableError, probe

# Each new client of httpx loads all certificates anew, which takes 30 ms. The tests make thousands and need none.
httpx._transports.default.create_ssl_context = functools.cache(httpx._transports.default.create_ssl_context)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the files with slow tests first, so that no worker is left alone with a long file at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session")
def bubblewrap() -> None:
    """Bubblewrap works here, or the test is skipped."""
    try:
        probe(None)
    except SandboxUnavailableError as error:
        pytest.skip(str(error))
