"""What can be checked of the container's files without an engine."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from wrongturn_agents.registry import list_agents
from wrongturn_protocol import Action, AgentKind, Track
from wrongturn_protocol.observations import observation_space
from wrongturn_service.settings import Settings

ROOT = Path(__file__).parents[2]
DOCKER = ROOT / "docker"


def test_the_image_installs_what_the_parts_need_and_constraints_know_it(tmp_path: Path) -> None:
    for part in ("clients", "networks", "service", "plugins/ray"):
        (tmp_path / part).mkdir(parents=True)
        shutil.copy(ROOT / part / "pyproject.toml", tmp_path / part)
    script = [sys.executable, str(DOCKER / "requirements.py"), "clients", "networks", "service[server]", "plugins/ray"]
    printed = subprocess.run(script, cwd=tmp_path, capture_output=True, text=True, check=True).stdout.split("\n")
    names = {re.split(r"[<>=\[~! ]", line)[0].lower() for line in printed if line}
    assert {"fastapi", "libsumo", "numba", "shapely", "pydantic", "ray", "typer"} <= names
    assert not {name for name in names if name.startswith("wrongturn") or name == "torch"}
    pinned = {
        line.split("==")[0].lower().replace("_", "-") for line in (ROOT / "constraints.txt").read_text().splitlines()
    }
    assert names <= pinned


def test_secrets_are_random_and_stay(tmp_path: Path) -> None:
    docker = tmp_path / "docker"
    docker.mkdir()
    for name in ("make-secrets", "example.env"):
        shutil.copy(DOCKER / name, docker)

    def made(folder: Path) -> dict[str, str]:
        subprocess.run([str(docker / "make-secrets"), str(folder)], check=True, capture_output=True)
        return {file.name: file.read_text() for file in folder.iterdir()}

    first, other = made(tmp_path / "a"), made(tmp_path / "b")
    assert first.keys() == {"database_password", "metrics_token", "operator_token", "ray_token"}
    assert len({*first.values(), *other.values()}) == 8
    assert all(re.fullmatch("[0-9a-f]{48}", secret) for secret in first.values())
    assert made(tmp_path / "a") == first
    assert (tmp_path / "a").stat().st_mode & 0o077 == 0
    assert (docker / ".env").read_text() == (DOCKER / "example.env").read_text()
    (docker / ".env").write_text("WRONGTURN_PORT=1\n")
    made(tmp_path / "a")
    assert (docker / ".env").read_text() == "WRONGTURN_PORT=1\n"
    ignored = (ROOT / ".gitignore").read_text().splitlines(), (ROOT / ".dockerignore").read_text().splitlines()
    assert {"docker/secrets/", "docker/.env"} <= {*ignored[0]}
    assert {"docker/secrets", "docker/.env"} <= {*ignored[1]}


def test_a_token_is_replaced_in_its_file(tmp_path: Path) -> None:
    """The same file: a container that has it mounted does not see another one in its place."""
    (tmp_path / "operator_token").write_text("old")
    before = (tmp_path / "operator_token").stat().st_ino

    def renew(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [str(DOCKER / "make-secrets"), "--new", *arguments],
            env={"PATH": os.environ["PATH"], "WRONGTURN_SECRETS": str(tmp_path)},
            capture_output=True,
            text=True,
            check=False,
        )

    done = renew("operator_token")
    assert done.returncode == 0, done.stderr
    token = (tmp_path / "operator_token").read_text()
    assert re.fullmatch("[0-9a-f]{48}", token)
    assert token not in done.stdout
    assert (tmp_path / "operator_token").stat().st_ino == before
    for wrong in ((), ("database_password",), ("nothing",)):
        assert renew(*wrong).returncode == 2


def test_compose_hardens_everything_and_keeps_no_password() -> None:
    text = (DOCKER / "compose.yaml").read_text()
    services = yaml.safe_load(text)["services"]
    for name, service in services.items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        for variable in service.get("environment", {}):
            assert not re.search("PASSWORD$|TOKEN$", variable), name
    assert services["database"]["user"] == "postgres"
    assert services["database"]["networks"] == ["inside"]
    assert "ports" not in services["database"]
    assert not re.search(r"PASSWORD:-|TOKEN:-|://\w+:\w+@", text)


OF_THE_USER = {
    "${WRONGTURN_AGENT_FOLDER:-./agent}:/agent:ro",
    "${WRONGTURN_OWNER_TOKEN_FILE:-/dev/null}:/run/secrets/owner_token:ro",
}
"""What an agent of somebody else reads of the host."""


def test_each_volume_has_a_name() -> None:
    """Each 'down' would leave one without behind."""
    compose = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    for name, service in compose["services"].items():
        for volume in {*service.get("volumes", ())} - (OF_THE_USER if name == "agent" else set()):
            source, colon, _ = volume.partition(":")
            assert colon, f"{name}: {volume}"
            assert source in compose["volumes"], f"{name}: {volume}"


def test_each_shipped_agent_but_the_exploits_has_a_profile() -> None:
    services = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]
    workers = {name for name, service in services.items() if service.get("profiles", ["ray"]) != ["ray"]}
    workers -= {"agent", "register"}
    assert workers == {agent.name for agent in list_agents() if agent.kind is not AgentKind.EXPLOIT}
    for name in workers:
        assert (services[name]["profiles"], services[name]["command"]) == ([name], [name])


def test_the_runner_has_nothing_but_its_socket() -> None:
    compose = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    runner, service = compose["services"]["runner"], compose["services"]["service"]
    assert runner["network_mode"] == runner["ipc"] == "none"
    assert not {"ports", "networks", "secrets", "environment", "env_file", "depends_on"} & runner.keys()
    assert runner["volumes"] == ["sandboxes:/run/wrongturn"]
    assert "sandboxes:/run/wrongturn:ro" in service["volumes"]
    assert service["environment"]["WRONGTURN_RUNNER_SOCKET"] in runner["command"]
    assert all(options.split(":")[1].split(",")[0] == "ro" for options in runner["tmpfs"])
    assert {"mem_limit", "memswap_limit", "cpus", "pids_limit"} <= runner.keys()
    # The socket's volume holds nothing else: it is as large as a page or two, and its user is the runner's.
    options = dict(part.partition("=")[::2] for part in compose["volumes"]["sandboxes"]["driver_opts"]["o"].split(","))
    dockerfile = (DOCKER / "service.Dockerfile").read_text()
    (user,) = re.findall(rf"useradd --system --uid (\d+) --gid runner .*\b{runner['user']}\b", dockerfile)
    (group,) = re.findall(r"groupadd --system --gid (\d+) runner", dockerfile)
    assert (options["uid"], options["gid"], options["size"]) == (user, group, "64k")
    assert re.search(r"useradd .*--groups runner .*wrongturn", dockerfile)


def test_nodes_of_ray_have_the_clusters_secret_alone_and_reach_the_service_alone() -> None:
    compose = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    nodes = {name: one for name, one in compose["services"].items() if one.get("profiles") == ["ray"]}
    assert nodes.keys() == {"ray-head", "ray-worker-1", "ray-worker-2"}
    for node in nodes.values():
        assert not {"ports", "env_file", "volumes", "depends_on"} & node.keys()
        assert (node["networks"], node["secrets"]) == (["simulators"], ["ray_token"])
    assert compose["networks"]["simulators"]["internal"]
    shared = {name for name, one in compose["services"].items() if "simulators" in one.get("networks", ())}
    assert shared - nodes.keys() == {"service"}


DECIDED = {
    "WRONGTURN_HOST",
    "WRONGTURN_PORT",
    "WRONGTURN_HOME",
    "WRONGTURN_DATABASE",
    "WRONGTURN_DATABASE_PASSWORD_FILE",
    "WRONGTURN_OPERATOR_TOKEN_FILE",
    "WRONGTURN_METRICS_TOKEN_FILE",
    "WRONGTURN_RUNNER_SOCKET",
}
"""Settings that compose decides. What stands in ``environment`` wins over the file."""


def test_each_setting_but_those_that_compose_decides_comes_from_the_file() -> None:
    service = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]["service"]
    assert service["env_file"] == ["${WRONGTURN_ENV_FILE:-.env}"]
    assert {name for name in service["environment"] if name.startswith("WRONGTURN_")} == DECIDED
    assert {f"WRONGTURN_{name.upper()}" for name in Settings.model_fields} > DECIDED
    page = (ROOT / "docs/compose.md").read_text("utf-8")
    (told,) = re.findall(r"Compose decides these itself: (.*?)\.\n", page, re.DOTALL)
    assert set(re.findall(r"`(WRONGTURN_\w+)`", told)) == DECIDED


def test_the_example_names_only_settings_and_variables_of_compose() -> None:
    named = re.findall(r"^#?(WRONGTURN_\w+)=", (DOCKER / "example.env").read_text("utf-8"), re.MULTILINE)
    settings = {f"WRONGTURN_{name.upper()}" for name in Settings.model_fields} - DECIDED
    variables = set(re.findall(r"\$\{(\w+):-", (DOCKER / "compose.yaml").read_text("utf-8")))
    assert set(named) <= settings | variables
    page = (ROOT / "docs/compose.md").read_text("utf-8").split("\n## Secrets")[0]
    of_compose = set(re.findall(r"^\| `(WRONGTURN_\w+)` \|", page, re.MULTILINE))
    of_an_agent = {"WRONGTURN_AGENT_FOLDER", "WRONGTURN_AGENT_IMAGE", "WRONGTURN_OWNER_TOKEN_FILE"}
    assert of_compose == variables - of_an_agent


def test_each_container_has_limits_and_a_log_that_ends() -> None:
    services = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]
    for name, service in services.items():
        assert service["mem_limit"] == service["memswap_limit"], name
        assert service["pids_limit"] > 0, name
        assert service["logging"]["options"].keys() == {"max-size", "max-file"}, name
        assert all("size=" in folder for folder in service["tmpfs"]), name


def test_only_the_service_and_the_operators_step_have_the_operators_token() -> None:
    services = yaml.safe_load((DOCKER / "compose.yaml").read_text())["services"]
    assert {name for name, service in services.items() if "operator_token" in str(service)} == {"service", "register"}
    workers = {name for name, service in services.items() if service.get("profiles") == [name]} - {"agent", "register"}
    assert {volume.split(":")[0] for volume in services["register"]["volumes"]} == workers
    for name in workers:
        assert services[name]["volumes"] == [f"{name}:/var/lib/wrongturn"]
        assert services[name]["environment"]["WRONGTURN_TOKEN_FILE"] == "/var/lib/wrongturn/token"
        assert "secrets" not in services[name]
    assert f"/agents/{name}" in str(services["register"]["volumes"])


def test_an_agent_of_somebody_else_gets_its_owners_token_alone() -> None:
    compose = yaml.safe_load((DOCKER / "compose.yaml").read_text())
    agent = compose["services"]["agent"]
    assert "secrets" not in agent
    assert set(agent["volumes"]) == OF_THE_USER | {"agent-runs:/var/lib/wrongturn"}
    assert agent["networks"] == ["agents"]
    assert compose["networks"]["agents"]["internal"]
    assert [name for name, service in compose["services"].items() if "agents" in service.get("networks", ())] == [
        "service",
        "agent",
    ]
    assert [name for name, service in compose["services"].items() if "agent-runs" in str(service)] == ["agent"]


def test_the_page_on_containers_shows_the_folders_module() -> None:
    page = (ROOT / "docs/submitting.md").read_text("utf-8")
    (shown,) = re.findall(r'```python title="my_agents.py"\n(.*?)```', page, re.DOTALL)
    assert shown == (DOCKER / "agent/my_agents.py").read_text("utf-8")
    made: dict[str, Any] = {}
    exec(shown, made)
    agent = made["Slow"]()
    space = observation_space(Track(agent.track))
    agent.reset(space)
    assert isinstance(agent.act(space.sample()), Action)


IMAGES = ["service.Dockerfile", "worker.Dockerfile"]


@pytest.mark.parametrize("image", IMAGES)
def test_the_old_builder_can_build_it(image: str) -> None:
    text = (DOCKER / image).read_text()
    assert not re.search(r"--mount|<<|^#\s*syntax", text, re.MULTILINE)
    assert re.search("^USER wrongturn$", text, re.MULTILINE)


@pytest.mark.parametrize("image", IMAGES)
def test_what_the_image_is_built_from_is_sent_to_the_engine(image: str) -> None:
    text = (DOCKER / image).read_text()
    sent = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = [source for line in re.findall(r"^COPY (.+)", text, re.MULTILINE) for source in line.split()[:-1]]
    assert copied
    assert [source for source in copied if not any(Path(source).is_relative_to(one) for one in sent)] == []
