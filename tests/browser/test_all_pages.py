"""What holds for every page: its width, its keyboard path, axe-core in both colours, and its text without scripts."""

import re
from html import unescape
from urllib.parse import urljoin, urlsplit

import httpx
import pytest
from all_pages import page_paths
from filled_site import SUITE, Site
from playwright.sync_api import Page
from visiting import Accessible, Visit

NAMES = ["leaderboard", "agents", "agent", "compare", "episode", "suites", "suite", "towns", "town"]
NAMES += ["submit", "docs", "keys", "about"]
DARK = NAMES[::2]
"""Pages that the shorter run looks at in dark colours; at the others in light ones. The longer run takes both."""
SHORTER = {"leaderboard", "agents", "episode"}
"""Pages whose keyboard path the shorter run follows; the longer run follows all."""
WRONG = {
    "/agents/ag_nobody": (404, "ag_nobody"),
    "/agents/{agent}?suite=nothing@1": (404, "nothing@1"),
    "/agents/{agent}?evaluation=ev_nothing": (404, "ev_nothing"),
    "/agents/{agent}?verdict=wonderful": (422, "verdict"),
    "/agents/{agent}?suite=wrong-command@3": (200, "finished no evaluation on wrong-command@3"),
    "/agents?page=7": (422, "from 1 to 1"),
    f"/leaderboards/{SUITE}/compare?a=careful&b=nobody": (404, "nobody"),
    f"/leaderboards/{SUITE}/compare?a=careful&b=careful": (422, "the same agent"),
    "/leaderboards/nothing@1": (404, "nothing@1"),
    "/episodes/ep_nothing": (404, "ep_nothing"),
    "/suites/nothing@9": (404, "nothing@9"),
    "/towns/Atlantis": (404, "Atlantis"),
    "/submit?suite=nothing@1": (404, "nothing@1"),
}
"""Addresses of what does not exist, with the status and a word of the page that says so."""
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


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("usual", [True, pytest.param(False, marks=pytest.mark.soak)])
def test_a_page_fits_and_is_accessible(
    visit: Visit, accessible: Accessible, paths: dict[str, str], name: str, usual: bool
):
    page = ready(visit(paths[name], width=400, dark=(name in DARK) is usual))
    if name != "docs":  # axe-core takes long for it; test_rest.py runs it
        accessible(page)
    for width in (400, 1000, 1600):
        page.set_viewport_size({"width": width, "height": 800})
        assert page.evaluate("document.documentElement.scrollWidth") <= width, width


def test_what_does_not_exist_is_said(visit: Visit, accessible: Accessible, site: Site):
    agent = site.agents["careful"]
    for path, (status, said) in WRONG.items():
        reply = httpx.get(site.url + path.format(agent=agent), headers={"Accept": BROWSER}, timeout=60)
        assert (reply.status_code, said in unescape(reply.text)) == (status, True), path
    accessible(visit("/agents/ag_nobody", status=404))


@pytest.mark.parametrize(
    "name", [name if name in SHORTER else pytest.param(name, marks=pytest.mark.soak) for name in NAMES]
)
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


def test_pages_can_be_read_without_scripts(visit: Visit, paths: dict[str, str]):
    for path in paths.values():
        page = visit(path, javascript=False)
        assert page.inner_text("h1")
        assert len(page.inner_text("main")) > 100
        assert page.locator("nav[aria-label=Main] a").count() >= 5


@pytest.mark.parametrize("most", [60, pytest.param(400, marks=pytest.mark.soak)])
def test_every_link_leads_somewhere(site: Site, paths: dict[str, str], most: int):
    with httpx.Client(base_url=site.url, timeout=60, headers={"Accept": BROWSER}) as http:
        known = set(paths.values()) | {"/"}
        waiting = sorted(known)
        checked = 0
        while waiting and checked < most:
            path = waiting.pop(0)
            checked += 1
            response = http.get(path)
            assert response.status_code == 200, path
            if "text/html" not in response.headers["content-type"]:
                continue
            ids = set(re.findall(r'\sid="([^"]+)"', response.text))
            for href in map(unescape, re.findall(r'<a\s[^>]*?href="([^"]+)"', response.text)):
                target, _, fragment = urljoin(path, href).partition("#")
                # It stays within the folder in which a proxy serves the pages.
                assert urlsplit(href).netloc or urljoin(f"/deep{path}", href).startswith("/deep/"), f"{path}: {href}"
                if href.startswith("#"):
                    assert fragment in ids, f"{path}: {href}"
                elif target.startswith("/") and target not in known:
                    known.add(target)
                    waiting.append(target)
