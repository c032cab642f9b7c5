"""The configurations and commands of compose.md, with a real nginx before a service."""

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
from clocked_service import ClockedService
from fake_pool import FakePool
from nginx_program import free_port, nginx
from service_harness import GAS, OPERATOR, expect, metrics, problem

from wrongturn_client import Action, Client
from wrongturn_protocol import EvaluationState

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "compose.md").read_text("utf-8")
INSIDE = "127.0.0.4"
"""The operator's network."""
JSON = {"Content-Type": "application/json"}
PRACTICE = {"town": "Town01", "approach": "J3-S", "seed": 3}


@dataclass(frozen=True)
class Proxied:
    """A service behind nginx."""

    service: ClockedService
    url: str
    plain_url: str
    """Where nginx sends people to TLS."""
    authority: Path
    """Certificate of the lab's authority."""
    log: Path

    def http(self, **options: Any) -> httpx.Client:
        return httpx.Client(base_url=f"{self.url}/", verify=str(self.authority), timeout=60, **options)


@pytest.fixture(scope="module")
def proxied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Proxied]:
    folder = tmp_path_factory.mktemp("nginx")
    make_certificates(folder)
    plain, secure = free_port(), free_port()
    url = f"https://localhost:{secure}/wrongturn"
    settings = {"trusted_proxies": "127.0.0.1,::1", "public_url": url, "operator_token": OPERATOR}
    service = ClockedService(folder / "wrongturn.db", pool=FakePool(4), registration_limit=4, **settings)
    written = configuration(folder, {80: plain, 443: secure, 8000: httpx.URL(service.url).port})
    try:
        with nginx(folder, written, secure):
            yield Proxied(service, url, f"http://localhost:{plain}", folder / "lab-ca.crt", folder / "error.log")
    finally:
        service.close()


def configuration(folder: Path, ports: dict[int, int | None]) -> str:
    """The page's configuration with the test's name, ports and folder."""
    text, inner, operators = re.findall(r"```nginx\n(.*?)```", PAGE, re.DOTALL)
    for directive in ("listen 80;", "listen 443 ssl;", "server 127.0.0.1:8000;"):
        assert text.count(directive) == 1
        port = int(re.search(r"\b(80|443|8000)\b", directive)[1])  # type: ignore[index]
        text = text.replace(directive, re.sub(rf"\b{port}\b", str(ports[port]), directive))
    text = text.replace("/etc/nginx/", f"{folder}/").replace("lab.example", "localhost")
    assert operators.count("10.0.0.0/8") == 1
    # As of the section on several proxies: here the outer one is this machine.
    more = inner.replace("192.0.2.10", "127.0.0.2") + operators.replace("10.0.0.0/8", INSIDE)
    return text.replace("    proxy_http_version", f"{more}\n    proxy_http_version", 1)


def make_certificates(folder: Path) -> None:
    commands = [line for line in PAGE.splitlines() if line.startswith("openssl ")]
    assert len(commands) == 3
    for command in commands:
        told = command.replace("DNS:lab.example", "DNS:localhost")
        subprocess.run(["sh", "-euc", told], cwd=folder, capture_output=True, check=True)
    for name in ("crt", "key"):
        (folder / f"lab.example.{name}").rename(folder / f"localhost.{name}")


def test_pages_their_files_and_their_commands(proxied: Proxied) -> None:
    with proxied.http(headers={"Accept": "text/html"}) as http:
        front = http.get("")
        assert front.status_code == 200
        assert front.headers["Content-Security-Policy"].startswith("default-src 'none'")
        for link in re.findall(r'(?:href|src)="([^"]+)"', front.text):
            assert http.get(front.url.join(link)).status_code == 200, link
        assert f"--url {proxied.url}</code>" in http.get("submit").text
        assert f"export WRONGTURN_URL={proxied.url}" in http.get("docs").text
        moved = http.get("towns/Town01/")
        assert moved.status_code == 308
        assert str(moved.url.join(moved.headers["Location"])) == f"{proxied.url}/towns/Town01"
        assert http.get(f"{proxied.url}/deeper/than/this").status_code == 404
        assert http.get("openapi.json").json()["servers"] == [{"url": proxied.url}]
        bare = http.get(proxied.url)
        assert (bare.status_code, bare.headers["Location"]) == (301, f"{proxied.url}/")
    lost = httpx.get(f"{proxied.plain_url}/wrongturn/towns?a=b", timeout=60)
    assert (lost.status_code, lost.headers["Location"]) == (308, "https://localhost/wrongturn/towns?a=b")


def test_metrics_are_not_for_strangers(proxied: Proxied) -> None:
    with proxied.http(headers={"Authorization": f"Bearer {OPERATOR}"}) as http:
        assert http.get("metrics").status_code == 404
        assert expect(http.get("health/ready"), 200)["status"] == "ok"
    assert "wrongturn_steps_total" in httpx.get(f"{proxied.service.url}/metrics", headers=http.headers, timeout=60).text


def test_the_operators_calls_stay_inside_the_network(proxied: Proxied) -> None:
    def from_(address: str, path: str) -> int:
        transport = httpx.HTTPTransport(verify=context(proxied), local_address=address)
        with proxied.http(transport=transport, headers={"Authorization": f"Bearer {OPERATOR}"}) as http:
            return http.get(path).status_code

    assert from_(INSIDE, "v1/admin/owners") == 200
    for path in ("v1/admin/owners", "v1/admin/usage", "v1//%61dmin/owners", "v1/admin%2Fowners"):
        assert from_("127.0.0.5", path) == 403, path
    assert from_("127.0.0.5", "v1/owners") == 200


def test_an_agent_drives_over_both_ways(proxied: Proxied, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(httpx._transports.default, "create_ssl_context", httpx.create_ssl_context)  # tests share one
    monkeypatch.setenv("SSL_CERT_FILE", str(proxied.authority))
    with Client(proxied.url) as client:
        token = client.register("behind nginx", "privileged").token
    with Client(proxied.url, token) as client:
        assert client.evaluate(Gas(), "smoke@3").state is EvaluationState.FINISHED
        opened = httpx.post(f"{proxied.url}/v1/episodes", **call(proxied, token, PRACTICE), timeout=60)
        begun = expect(opened, 201)["id"]
        step = call(proxied, token, {"seq": 1, "action": GAS})
        expect(httpx.post(f"{proxied.url}/v1/episodes/{begun}/step", **step, timeout=60), 200)
    counted = metrics(proxied.service.url)
    assert re.search(r'seconds_count{method="WS",route="/v1/drive step",status="200"} 1[12]\d\.0', counted)
    assert len(re.findall(r'seconds_count{method="POST",route="/v1/episodes/{episode}/step"', counted)) == 1


def call(proxied: Proxied, token: str, body: object) -> dict[str, Any]:
    return {"json": body, "headers": {"Authorization": f"Bearer {token}"}, "verify": context(proxied)}


class Gas:
    """Drives on."""

    def reset(self, observation_space: object) -> None:
        pass

    def act(self, observation: object) -> Action:
        return Action(steer=0, throttle=0.5, brake=0)


def test_limits_go_by_the_clients_address_and_nobody_chooses_it(proxied: Proxied) -> None:
    def register(number: int, **headers: str) -> httpx.Response:
        with proxied.http(transport=httpx.HTTPTransport(verify=context(proxied), local_address="127.0.0.3")) as http:
            return http.post("v1/owners", json={"name": f"group {number}"}, headers=headers)

    for number in range(4):
        expect(register(number, **{"X-Forwarded-For": f"192.0.2.{number}"}), 201)
    problem(register(4, **{"X-Forwarded-For": "192.0.2.4"}), 429, "rate-limited")
    with proxied.http() as http:
        expect(http.post("v1/owners", json={"name": "another address"}), 201)


def context(proxied: Proxied) -> Any:
    return httpx.create_ssl_context(verify=str(proxied.authority))


def test_refusals_arrive_while_the_body_is_sent(proxied: Proxied) -> None:
    with proxied.http() as http:
        assert http.post("v1/owners", content=b"x" * (5 << 20), headers=JSON).status_code == 413, "nginx's own"
        large = {"content": b"x" * (3 << 20), "headers": JSON}
        problem(http.post("v1/owners", **large), 413, "body-too-large")
        large["content"] = b"x" * (1 << 20)
        problem(http.post(f"{proxied.service.url}/v1/owners", **large), 413, "body-too-large")
        form = {"files": {"model": b"x" * (20 << 20)}, "data": {"suite": "smoke@3", "name": "large"}}
        problem(http.post("v1/submissions", **form), 401, "unauthenticated")


def test_the_pages_commands(proxied: Proxied) -> None:
    environment = {**os.environ, "SSL_CERT_FILE": str(proxied.authority)}
    said = subprocess.run(
        [sys.executable, "-m", "wrongturn_client", "leaderboard", "smoke@3", "--url", proxied.url, "--json"],
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    assert '"smoke@3"' in said.stdout
    curl = ["curl", "-sS", "--cacert", str(proxied.authority), f"{proxied.url}/health/ready"]
    assert '"ok"' in subprocess.run(curl, capture_output=True, text=True, check=True).stdout
    without = subprocess.run(curl[:2] + curl[-1:], capture_output=True, text=True, check=False)
    assert "certificate" in without.stderr
