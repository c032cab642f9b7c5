"""Pages and their scripts behind a proxy that serves the service below a path."""

import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from all_pages import unsafe_episode
from filled_site import Site
from playwright.sync_api import Browser, Page

NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
CONFIGURATION = """
daemon off;
pid {folder}/pid;
error_log {folder}/error.log;
events {{}}
http {{
    access_log off;
    client_body_temp_path {folder}/body;
    proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi;
    scgi_temp_path {folder}/scgi;
    server {{
        listen 127.0.0.1:{port};
        location /deep/path/ {{
            proxy_pass {service}/;
            proxy_set_header Host $http_host;
            proxy_buffering off;
        }}
    }}
}}
"""


@pytest.fixture(scope="module")
def below(site: Site, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """URL of the site below a path."""
    if NGINX is None:
        pytest.skip("there is no nginx; apt-get install nginx")
    folder = tmp_path_factory.mktemp("nginx")
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        port = taken.getsockname()[1]
    file = folder / "nginx.conf"
    file.write_text(CONFIGURATION.format(folder=folder, port=port, service=site.url))
    nginx = subprocess.Popen([NGINX, "-p", str(folder), "-c", str(file)], stderr=subprocess.DEVNULL)
    try:
        await_file(folder / "pid")
        yield f"http://127.0.0.1:{port}/deep/path"
    finally:
        nginx.terminate()
        nginx.wait(60)


def await_file(path: Path) -> None:
    for _ in range(1200):
        if path.exists():
            return
        time.sleep(0.05)
    raise AssertionError("nginx does not start")


@pytest.fixture
def page(chromium: Browser, below: str) -> Iterator[Page]:
    """A page all of whose requests go below the path, and are answered."""
    context = chromium.new_context()
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


def test_a_replay_and_the_links_around_it(page: Page, below: str, site: Site) -> None:
    page.goto(below + "/")
    page.get_by_role("link", name="Agents", exact=True).click()
    assert page.url == f"{below}/agents"
    episode = unsafe_episode(site, site.evaluations["careful"])
    with page.expect_response(f"{below}/v1/towns/*"), page.expect_response(f"{below}/episodes/*/drive.json"):
        page.goto(f"{below}/episodes/{episode}")
    page.get_by_role("link", name="Suites", exact=True).click()
    assert page.url == f"{below}/suites"


def test_a_form_of_the_calls_sends_its_request_below_the_path(page: Page, below: str) -> None:
    page.goto(f"{below}/docs")
    details = page.locator("details", has=page.locator('form.try[data-path="/v1/suites"]')).first
    details.locator("summary").first.click()
    with page.expect_response(f"{below}/v1/suites"):
        details.get_by_role("button", name="Send GET").click()
