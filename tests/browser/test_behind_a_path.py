"""Pages and their scripts behind a proxy that serves the service below a path."""

from collections.abc import Iterator

import pytest
from all_pages import unsafe_episode
from filled_site import Site
from nginx_program import free_port, nginx
from playwright.sync_api import Browser, Page
from visiting import PATIENCE_MS

CONFIGURATION = """
server {{
    listen 127.0.0.1:{port};
    location /deep/path/ {{
        proxy_pass {service}/;
        proxy_set_header Host $http_host;
        proxy_buffering off;
    }}
}}
"""


@pytest.fixture(scope="module")
def below(site: Site, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """URL of the site below a path."""
    port = free_port()
    written = CONFIGURATION.format(port=port, service=site.url)
    with nginx(tmp_path_factory.mktemp("nginx"), written, port):
        yield f"http://127.0.0.1:{port}/deep/path"


@pytest.fixture
def page(chromium: Browser, below: str) -> Iterator[Page]:
    """A page all of whose requests go below the path, and are answered."""
    context = chromium.new_context()
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    wrong: list[str] = []
    page.on("response", lambda reply: wrong.append(f"{reply.status} {reply.url}") if reply.status >= 400 else None)
    page.on(
        "request", lambda request: None if request.url.startswith((f"{below}/", "data:")) else wrong.append(request.url)
    )
    page.on("pageerror", lambda error: wrong.append(str(error)))
    yield page
    context.close()
    assert not wrong


def test_a_replay_links_and_forms(page: Page, below: str, site: Site) -> None:
    page.goto(below + "/")
    page.get_by_role("link", name="Agents", exact=True).click()
    assert page.url == f"{below}/agents"
    episode = unsafe_episode(site, site.evaluations["careful"])
    with page.expect_response(f"{below}/v1/towns/*"), page.expect_response(f"{below}/episodes/*/drive.json"):
        page.goto(f"{below}/episodes/{episode}")
    page.get_by_role("link", name="Suites", exact=True).click()
    assert page.url == f"{below}/suites"
    page.goto(f"{below}/docs")
    details = page.locator("details", has=page.locator('form.try[data-path="/v1/suites"]')).first
    details.locator("summary").first.click()
    with page.expect_response(f"{below}/v1/suites"):
        details.get_by_role("button", name="Send GET").click()
