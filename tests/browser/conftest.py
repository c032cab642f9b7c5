"""A filled service and a real Chromium. Every page that a test opens has to be free of errors."""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Browser, Page, Request, expect, sync_playwright

# The helpers of the service's tests are imported by their plain names.
sys.path.insert(0, str(Path(__file__).parents[1] / "service"))
sys.path.insert(0, str(Path(__file__).parent))

from filled_site import Site, filled_site
from visiting import CHROMIUM, OPTIONS, PATIENCE_MS, Accessible, Visit

expect.set_options(timeout=PATIENCE_MS)

_EXPECTED = "Failed to load resource: the server responded with a status of "
"""Chromium logs it for a page that is an error page, and for a call that is refused."""


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """A service with two driven agents, which tests share."""
    with filled_site(tmp_path_factory.mktemp("site")) as site:
        yield site


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """Chromium, or the test is skipped.

    Playwright keeps an event loop in this thread. It stops after each file, so that tests elsewhere can run theirs.
    """
    if not CHROMIUM.exists():
        pytest.skip(f"there is no {CHROMIUM}; apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=list(OPTIONS), timeout=PATIENCE_MS)
        yield browser
        browser.close()


@pytest.fixture
def visit(chromium: Browser, site: Site) -> Iterator[Visit]:
    """Open a path of the site: ``visit("/", width=400, dark=True, javascript=False)``.

    The test fails if a page has an error in its console, breaks its Content-Security-Policy, or calls another origin.
    """
    wrong: list[str] = []
    contexts = []

    def open_page(
        path: str,
        *,
        width: int = 1000,
        dark: bool = False,
        javascript: bool = True,
        status: int = 200,
        refusals: bool = False,
    ) -> Page:
        context = chromium.new_context(
            base_url=site.url,
            viewport={"width": width, "height": 800},
            color_scheme="dark" if dark else "light",
            java_script_enabled=javascript,
            reduced_motion="reduce",
        )
        context.set_default_timeout(PATIENCE_MS)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda said: _note(wrong, refusals or status != 200, said.type, said.text))
        page.on("pageerror", lambda error: wrong.append(f"{path}: {error}"))
        page.on("requestfailed", lambda request: _failed(wrong, request))
        page.on("request", lambda request: _check_origin(wrong, site.url, request.url))
        response = page.goto(path)
        assert response is not None
        assert response.status == status
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert not wrong


def _note(wrong: list[str], refusals: bool, kind: str, text: str) -> None:
    if kind in {"error", "warning"} and not (refusals and text.startswith(_EXPECTED)):
        wrong.append(f"console: {text}")


def _failed(wrong: list[str], request: Request) -> None:
    if request.failure != "net::ERR_ABORTED":  # the test has gone on to another page
        wrong.append(f"{request.url}: {request.failure}")


def _check_origin(wrong: list[str], origin: str, url: str) -> None:
    if not url.startswith((origin, "data:", "blob:")):
        wrong.append(f"another origin: {url}")


@pytest.fixture(scope="session")
def accessible() -> Accessible:
    """Check a page by axe-core."""
    axe = Axe()

    def check(page: Page) -> None:
        found: Any = axe.run(page)
        assert found.violations_count == 0, found.generate_report()

    return check
