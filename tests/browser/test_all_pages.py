"""What holds for every page: its width, its keyboard path, axe-core in both colours, and its text without scripts."""

import re
from html import unescape
from urllib.parse import urljoin

import httpx
import pytest
from all_pages import page_paths
from filled_site import SUITE, Site
from playwright.sync_api import Page
from visiting import Accessible, Visit

NAMES = ["leaderboard", "agents", "agent", "compare", "episode", "suites", "suite", "towns", "town", "submit", "docs"]
IN_CI = {"leaderboard", "agents", "episode"}
"""The other pages are looked at by the longer run. Their own tests run axe-core in CI."""
EACH = [name if name in IN_CI else pytest.param(name, marks=pytest.mark.soak) for name in NAMES]
LOOKED_AT_ELSEWHERE = "docs"
"""axe-core takes long for this page; ``test_rest.py`` runs it in both colours."""
BROWSER = "text/html,application/xhtml+xml,application/xml;q=0.9,*/*;q=0.8"
"""What a browser accepts."""
TABS = 40
"""Stops of the keyboard that are looked at on each page."""


@pytest.fixture(scope="module")
def paths(site: Site) -> dict[str, str]:
    found = page_paths(site, SUITE)
    assert list(found) == NAMES
    return found


def ready(page: Page) -> Page:
    """Wait for the replay, if the page has one: until then its controls are hidden."""
    if page.locator(".player").count():
        page.wait_for_selector("[data-ready]")
    return page


@pytest.mark.parametrize("name", EACH)
def test_a_page_fits_and_is_accessible_in_both_colours(
    visit: Visit, accessible: Accessible, paths: dict[str, str], name: str
):
    page = ready(visit(paths[name], width=400, dark=True))
    for width in (400, 1000, 1600):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width, width
    if name != LOOKED_AT_ELSEWHERE:
        accessible(page)
        page.emulate_media(color_scheme="light")
        page.set_viewport_size({"width": 400, "height": 800})
        accessible(page)


@pytest.mark.parametrize("name", EACH)
def test_the_keyboard_reaches_everything_in_order(visit: Visit, paths: dict[str, str], name: str):
    page = ready(visit(paths[name]))
    expected = page.evaluate(
        """() => {
            const kinds = "a[href], button, input, select, textarea, summary, [tabindex='0']";
            const found = [...document.querySelectorAll(kinds)].filter(
                (item) => item.checkVisibility() && !item.disabled && item.tabIndex >= 0);
            window.stops = found;
            return found.length;
        }"""
    )
    reached = []
    for _ in range(min(TABS, expected)):
        page.keyboard.press("Tab")
        reached.append(page.evaluate("window.stops.indexOf(document.activeElement)"))
        if reached[-1] >= 0:
            assert seen(page), page.evaluate("document.activeElement.outerHTML.slice(0, 200)")
    # A group of radio buttons is one stop.
    assert reached[0] == 0
    assert -1 not in reached
    assert reached == sorted(set(reached))


def seen(page: Page) -> bool:
    """Whether what has the focus is marked, and on the screen."""
    found: bool = page.evaluate(
        """() => {
            const item = document.activeElement;
            const style = getComputedStyle(item);
            const box = item.getBoundingClientRect();
            return style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2
                && box.width > 0 && box.bottom > 0 && box.top < innerHeight;
        }"""
    )
    return found


@pytest.mark.parametrize("name", EACH)
def test_a_page_can_be_read_without_scripts(visit: Visit, paths: dict[str, str], name: str):
    page = visit(paths[name], javascript=False)
    assert page.inner_text("h1")
    assert len(page.inner_text("main")) > 100
    assert page.locator("nav[aria-label=Main] a").count() >= 5


def test_every_link_leads_somewhere(site: Site, paths: dict[str, str]):
    with httpx.Client(base_url=site.url, timeout=60, headers={"Accept": BROWSER}) as http:
        known = set(paths.values()) | {"/"}
        waiting = sorted(known)
        checked = 0
        while waiting and checked < 120:
            path = waiting.pop(0)
            checked += 1
            response = http.get(path)
            assert response.status_code == 200, path
            if "text/html" not in response.headers["content-type"]:
                continue
            ids = set(re.findall(r'\sid="([^"]+)"', response.text))
            for href in map(unescape, re.findall(r'<a\s[^>]*?href="([^"]+)"', response.text)):
                target, _, fragment = urljoin(path, href).partition("#")
                if href.startswith("#"):
                    assert fragment in ids, f"{path}: {href}"
                elif target.startswith("/") and target not in known:
                    known.add(target)
                    waiting.append(target)
