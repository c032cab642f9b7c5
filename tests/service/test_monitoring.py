"""Prometheus and its tools take what docker/monitoring holds, and the service has each metric that is asked for."""

import json
import re
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from clocked_service import ClockedService
from fake_pool import FakePool
from prometheus_client.parser import text_string_to_metric_families
from service_harness import OPERATOR, expect, metrics

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docker/monitoring"
PAGE = (ROOT / "docs/monitoring.md").read_text("utf-8")
TOKEN = "the-token-of-the-metrics"
_METRIC = re.compile(r"\b(?:wrongturn|process)_\w+\b(?!\")")
_SUFFIX = re.compile(r"_(total|bucket|count|sum)$")


def rules() -> list[dict[str, Any]]:
    (group,) = yaml.safe_load((FOLDER / "alerts.yml").read_text("utf-8"))["groups"]
    return list(group["rules"])


def queries() -> list[str]:
    """What the dashboard asks for, with values for Grafana's variables."""
    board = json.loads((FOLDER / "dashboard.json").read_text("utf-8"))
    found = [target["expr"] for panel in board["panels"] for target in panel.get("targets", [])]
    assert len(found) > 30
    return [expr.replace("$__rate_interval", "1m").replace("$instance", ".*") for expr in found]


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ClockedService]:
    folder = tmp_path_factory.mktemp("monitored")
    running = ClockedService(folder / "wrongturn.db", pool=FakePool(4), metrics_token=TOKEN, operator_token=OPERATOR)
    try:
        with running.agent() as agent:
            expect(agent.step(agent.practise()["id"], 1), 200)
        yield running
    finally:
        running.close()


@pytest.fixture
def promtool(tmp_path: Path) -> Callable[..., None]:
    found = tool("promtool")

    def run(*arguments: str, **options: Any) -> None:
        done = subprocess.run([found, *arguments], capture_output=True, text=True, check=False, cwd=tmp_path, **options)
        assert done.returncode == 0, done.stdout + done.stderr

    return run


def tool(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"there is no {name}; apt-get install prometheus")
    return found


def test_promtool_takes_the_files_and_plays_each_alert(promtool: Callable[..., None], tmp_path: Path) -> None:
    shutil.copytree(FOLDER, tmp_path, dirs_exist_ok=True)
    (tmp_path / "metrics_token").write_text(TOKEN)
    promtool("check", "config", "prometheus.yml")
    promtool("test", "rules", "alerts_test.yml")
    played = yaml.safe_load((FOLDER / "alerts_test.yml").read_text("utf-8"))["tests"]
    raised = {case["alertname"] for test in played for case in test["alert_rule_test"] if case["exp_alerts"]}
    assert raised == {rule["alert"] for rule in rules()}


def test_promtool_takes_the_services_metrics(promtool: Callable[..., None], service: ClockedService) -> None:
    promtool("check", "metrics", input=metrics(service.url))


def test_the_service_has_each_metric_that_is_asked_for(service: ClockedService) -> None:
    there = {family.name for family in text_string_to_metric_families(metrics(service.url))}
    for asked in (*queries(), *(rule["expr"] for rule in rules())):
        for name in _METRIC.findall(asked):
            assert _SUFFIX.sub("", name) in there, asked


def test_the_page_says_what_to_do_at_each_alert() -> None:
    told = dict(re.findall(r"^\| `(Wrongturn\w+)` \| (page|ticket) \| .{40,}", PAGE, re.MULTILINE))
    assert told == {rule["alert"]: rule["labels"]["severity"] for rule in rules()}


def test_prometheus_reads_a_service_and_answers_the_dashboard(service: ClockedService, tmp_path: Path) -> None:
    program = tool("prometheus")
    shutil.copytree(FOLDER, tmp_path, dirs_exist_ok=True)
    (tmp_path / "metrics_token").write_text(f"{TOKEN}\n")
    written = (FOLDER / "prometheus.yml").read_text("utf-8").replace("15s", "1s")
    (tmp_path / "prometheus.yml").write_text(written.replace("127.0.0.1:8000", service.url.removeprefix("http://")))
    with closing(socket.create_server(("127.0.0.1", 0))) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
    command = [program, "--config.file=prometheus.yml", "--storage.tsdb.path=data", f"--web.listen-address={address}"]
    running = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.DEVNULL)
    try:
        with httpx.Client(base_url=f"http://{address}/api/v1/", timeout=120) as http:
            await_result(http, 'up{job="wrongturn"} == 1')
            await_result(http, "wrongturn_build_info")
            for expr in queries():
                found = http.get("query", params={"query": expr}).json()
                assert found["status"] == "success", (expr, found)
            (group,) = http.get("rules").json()["data"]["groups"]
            assert {rule["name"]: rule["health"] for rule in group["rules"]}.keys() == {r["alert"] for r in rules()}
    finally:
        running.terminate()
        running.wait(60)


def await_result(http: httpx.Client, query: str) -> None:
    for _ in range(1200):
        with suppress(httpx.TransportError):  # it starts
            answer = http.get("query", params={"query": query})
            if answer.status_code == 200 and answer.json()["data"]["result"]:  # 503 until it is ready
                return
        time.sleep(0.1)
    raise AssertionError(f"{query}: nothing within two minutes")
