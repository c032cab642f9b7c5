"""The containers as a lab's operator uses them: settings, limits, ``doctor``, backups, and the tokens of workers.

It needs a Docker engine and takes minutes, so it runs only where one answers: ``pytest -m soak tests/system``.
"""

import json
import re
import subprocess

import pytest
from system_compose_project import ROOT, Service, register

from wrongturn_service.settings import Settings

pytestmark = [pytest.mark.soak, pytest.mark.system, pytest.mark.timeout(1800)]

DOCUMENTED = re.findall(r"^\| `WRONGTURN_(\w+)` \|", (ROOT / "docs/settings.md").read_text("utf-8"), re.MULTILINE)
DECIDED = re.findall(
    r"`WRONGTURN_(\w+)`",
    (ROOT / "docs/compose.md").read_text("utf-8").split("Compose decides these itself: ")[1].split(".\n")[0],
)
OTHER_VALUES = {
    "REGISTRATION": "operator",
    "METRICS_PORT": "9123",
    "SIMULATORS": "3",
    "SUBMISSIONS": "7",
    "TRUSTED_PROXIES": "10.1.2.3,10.4.0.0/16",
    "LOG_LEVEL": "warning",
    "PUBLIC_URL": "https://wrongturn.example.org",
}
"""Values of settings whose default is no number."""
PRINT = "from wrongturn_service.settings import Settings; print(Settings().model_dump_json())"


def other_value(name: str) -> str:
    """A valid value that is not the default."""
    field = Settings.model_fields[name.lower()]
    if name in OTHER_VALUES:
        return OTHER_VALUES[name]
    if field.default is None and "int" in str(field.annotation):
        return "77"
    assert isinstance(field.default, int | float), f"give OTHER_VALUES a value of {name}"
    return str(field.default + 1)


def run(
    composed: Service, *arguments: str, given: bytes = b"", **environment: str
) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [*composed.command, *arguments],
        env={**composed.environment, **environment},
        cwd=ROOT,
        input=given,
        capture_output=True,
        check=False,
    )


def settings_of(composed: Service, **environment: str) -> dict[str, object]:
    """The settings that the service's container gets."""
    shown = run(composed, "run", "--rm", "--no-deps", "-T", "service", "python", "-c", PRINT, **environment)
    assert shown.returncode == 0, shown.stderr
    return json.loads(shown.stdout.splitlines()[-1])


def test_every_documented_setting_arrives(composed: Service) -> None:
    """Those that compose decides are as documented, whatever the file says of them."""
    secrets = {"OPERATOR_TOKEN", "METRICS_TOKEN"}  # these come from files, which exclude them
    wanted = {name: other_value(name) for name in DOCUMENTED if name not in {*DECIDED, *secrets}}
    file = composed.settings.with_name("all.env")
    overruled = "".join(f"WRONGTURN_{name}=/nowhere\n" for name in DECIDED)
    file.write_text("".join(f"WRONGTURN_{name}={value}\n" for name, value in wanted.items()) + overruled)
    arrived = settings_of(composed, WRONGTURN_ENV_FILE=str(file))
    assert len(wanted) > 30
    for name, value in wanted.items():
        found = arrived[name.lower()]
        assert type(found)(value) == found, name
    assert (arrived["host"], arrived["port"], arrived["home"]) == ("0.0.0.0", 8000, "/var/lib/wrongturn")
    assert arrived["operator_token_file"] == "/run/secrets/operator_token"


def test_doctor_is_content_in_a_healthy_container(composed: Service) -> None:
    shown = composed.compose("exec", "-T", "service", "wrongturn", "doctor")
    assert "All is well." in shown
    assert "is in use by a running service" in " ".join(shown.split())


def test_a_backup_from_the_services_container_and_back(composed: Service) -> None:
    """The commands of the documentation, but for their shell's redirections."""
    kept = register(composed, "kept by backup")
    made = run(composed, "exec", "-T", "service", "wrongturn", "backup", "-")
    assert made.stdout.startswith(b"PGDMP"), made.stderr
    register(composed, "gone by restore")
    restore = ("run", "--rm", "-T", "service", "wrongturn", "restore", "--yes", "-")
    refused = run(composed, *restore, given=made.stdout)
    assert refused.returncode == 1
    assert b"a service uses the database" in refused.stderr
    composed.compose("stop", "service")
    done = run(composed, *restore, given=made.stdout)
    assert done.returncode == 0, done.stderr
    composed.up()
    for name, status in (("kept by backup", 409), ("gone by restore", 201)):
        assert composed.call("POST", "/v1/agents", {"name": name, "track": "privileged"}).status == status, name
    assert composed.call("POST", "/v1/evaluations", {"suite": "smoke@3"}, kept["token"]).status == 201
    left = composed.compose("exec", "-T", "service", "find", "/var/lib/wrongturn", "-name", "*backup*")
    assert left == ""


def test_a_worker_without_a_token_says_what_is_missing(composed: Service) -> None:
    done = run(composed, "run", "--rm", "-T", "parked")
    assert done.returncode == 1
    assert b"WRONGTURN_TOKEN_FILE: /var/lib/wrongturn/token cannot be read" in done.stdout + done.stderr


LOOK_AT_HOME = "import os; print(os.listdir('/var/lib/wrongturn'), os.path.exists('/run/secrets'))"


def test_a_worker_has_its_own_token_alone(composed: Service) -> None:
    composed.compose("run", "--rm", "-T", "register", "always-stops", "obeys-blindly")
    found = composed.compose("run", "--rm", "-T", "--entrypoint", "python", "always-stops", "-c", LOOK_AT_HOME)
    assert found.strip() == "['token'] False"
    tokens = {
        composed.compose("run", "--rm", "-T", "--entrypoint", "cat", name, "/var/lib/wrongturn/token").strip()
        for name in ("always-stops", "obeys-blindly")
    }
    assert len(tokens) == 2
    assert (composed.secrets / "operator_token").read_text() not in tokens


LOOK_AT_SIMULATORS = """
import os, pathlib
for folder in pathlib.Path("/proc").glob("[0-9]*"):
    if "wrongturn_service.simulators" in (folder / "cmdline").read_text().split("\\0"):
        variables = (folder / "environ").read_text().split("\\0")
        names = sorted(pair.partition("=")[0] for pair in variables if pair)
        print(names, (folder / "oom_score_adj").read_text().strip())
"""


def test_a_simulator_has_no_secrets(composed: Service) -> None:
    found = composed.compose("exec", "-T", "service", "python", "-c", LOOK_AT_SIMULATORS).splitlines()
    assert found
    for line in found:
        assert not re.search("TOKEN|PASSWORD|DATABASE|SECRET", line), line
        assert line.endswith(" 500"), line
