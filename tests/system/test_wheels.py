"""The wheels are complete, agree on their versions, and each works with nothing but what it asks for."""

import re
import subprocess
import tarfile
import tomllib
import venv
import zipfile
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from system_bare_environment import ROOT, SOURCES, Wheels

PROJECTS: dict[str, dict[str, Any]] = {
    f"wrongturn-{part}": tomllib.loads((ROOT / folder / "pyproject.toml").read_text("utf-8"))["project"]
    for part, folder in SOURCES.items()
}
BUILT = ("client", "networks", "service", "openenv")
"""Parts whose wheels are built each time, beside that of wrongturn. Those of all others take a minute."""
META = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
HEAVY = {"fastapi", "libsumo", "numba", "onnx", "onnxruntime", "sqlalchemy", "stable-baselines3", "torch", "uvicorn"}
IMPORT_ALL = """
import importlib, pkgutil, sys
left_out = tuple(sys.argv[2:])
for name in sys.argv[1].split(","):
    for module in pkgutil.walk_packages(importlib.import_module(name).__path__, f"{name}."):
        if not module.name.endswith("__main__") and not module.name.startswith(left_out):
            importlib.import_module(module.name)
"""
DRIVE = """
import gymnasium
env = gymnasium.make("wrongturn_sim:WrongturnSim-v0", town="Town01", track="privileged", fault="infeasible")
env.reset(seed=7)
print(env.step(env.action_space.sample())[0]["lane"].shape)
env.close()
"""
ACT = """
import sys
import numpy as np
from wrongturn_agents.registry import resolve
from wrongturn_protocol.observations import observation_space
for name in sys.argv[1:]:
    agent = resolve(name).make()
    space = observation_space(agent.track)
    agent.reset(space)
    observation = {key: np.zeros(box.shape, box.dtype) for key, box in space.items()}
    print(type(agent.act({**observation, "command": np.array([4])})).__name__)
"""


def requirements(project: dict[str, Any]) -> list[Requirement]:
    extras = project.get("optional-dependencies", {}).values()
    return [Requirement(line) for lines in (project["dependencies"], *extras) for line in lines]


def build(folder: Path, *parts: str) -> Wheels:
    subprocess.run([ROOT / "script/wheels", folder, *parts], check=True, capture_output=True)
    return Wheels(folder)


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> Wheels:
    """Some wheels. The metadata of the other parts are those that are installed."""
    return build(tmp_path_factory.mktemp("wheels") / "dist", *(SOURCES[part] for part in BUILT), ".")


@pytest.fixture(scope="module")
def all_wheels(tmp_path_factory: pytest.TempPathFactory) -> Wheels:
    return build(tmp_path_factory.mktemp("all-wheels") / "dist")


def test_the_versions_agree() -> None:
    version = META["version"]
    assert {project["version"] for project in PROJECTS.values()} == {version}
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
    for project in (META, *PROJECTS.values()):
        for needed in requirements(project):
            if needed.name in PROJECTS:
                assert str(needed.specifier) == f"=={version}", f"{project['name']}: {needed}"


def test_wrongturn_brings_every_part_and_every_extra() -> None:
    brought = {(needed.name, extra) for needed in requirements(META) for extra in needed.extras or {""}}
    offered = {
        (name, extra) for name, project in PROJECTS.items() for extra in project.get("optional-dependencies", {})
    }
    assert brought - {("wrongturn", extra) for extra in META["optional-dependencies"]} <= offered | {
        (name, "") for name in PROJECTS
    }
    # The first is brought by a plugin's own name; the other is for those who have CUDA.
    assert offered - brought == {("wrongturn-agents", "figures"), ("wrongturn-service", "cuda")}
    (everything,) = (Requirement(line) for line in META["optional-dependencies"]["all"])
    assert everything.extras == META["optional-dependencies"].keys() - {"all", "agents", "ray", "sim"}


@pytest.mark.soak
def test_wheels_are_built_without_the_large_environment(tmp_path: Path) -> None:
    clone = tmp_path / "clone"
    subprocess.run(["git", "clone", "-q", ROOT, clone], check=True)
    subprocess.run([clone / "script/wheels", tmp_path / "dist", "networks", "."], check=True, capture_output=True)
    assert len(list((tmp_path / "dist").glob("*.whl"))) == 2
    assert not (clone / ".venv").exists()
    assert sum(file.stat().st_size for file in (clone / ".venv-wheels").rglob("*") if file.is_file()) < 50_000_000


def check_files(wheels: Wheels, name: str) -> None:
    """Check that a wheel has a part's files and no others, and that its sdist has what a wheel is built from."""
    packages: set[str] = set()
    if name in PROJECTS:
        folder = ROOT / SOURCES[name.removeprefix("wrongturn-")]
        git = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "wrongturn_*"]
        listed = subprocess.run(git, cwd=folder, capture_output=True, text=True, check=True).stdout.splitlines()
        packages = {file for file in listed if not file.endswith(".gitattributes") and (folder / file).exists()}
    with zipfile.ZipFile(wheels.paths[name]) as wheel:
        files = wheel.namelist()
    assert {file for file in files if ".dist-info/" not in file} == packages
    assert any(file.endswith("licenses/LICENSE") for file in files)
    (path,) = wheels.folder.glob(f"{name.replace('-', '_')}-{META['version']}.tar.gz")
    with tarfile.open(path) as sdist:
        inside = {file.name.partition("/")[2] for file in sdist.getmembers() if file.isfile() and file.size}
    assert {"LICENSE", "README.md", "pyproject.toml"} <= inside
    assert not {file for file in inside if file.startswith("test")}


@pytest.mark.parametrize("name", ["wrongturn", *(f"wrongturn-{part}" for part in BUILT)])
def test_a_wheel_has_the_parts_files_and_no_others(wheels: Wheels, name: str) -> None:
    check_files(wheels, name)


@pytest.mark.soak
@pytest.mark.timeout(900)
@pytest.mark.parametrize("name", [f"wrongturn-{part}" for part in SOURCES if part not in BUILT])
def test_the_other_wheels_have_their_files_too(all_wheels: Wheels, name: str) -> None:
    check_files(all_wheels, name)


@pytest.mark.parametrize(
    ("wanted", "heavy"),
    [
        ("wrongturn", set()),
        ("wrongturn-networks", set()),
        ("wrongturn-agents", set()),
        ("wrongturn-agents[onnx]", {"onnxruntime"}),
        ("wrongturn[sim]", {"libsumo", "numba"}),
        ("wrongturn[service]", HEAVY - {"stable-baselines3", "torch"}),
        ("wrongturn[training]", HEAVY - {"fastapi", "sqlalchemy", "uvicorn"}),
        ("wrongturn[all]", HEAVY),
    ],
)
def test_a_part_asks_for_nothing_heavy_that_it_does_not_need(wheels: Wheels, wanted: str, heavy: set[str]) -> None:
    assert wheels.closure(wanted) & HEAVY == heavy


@pytest.mark.parametrize(
    ("wanted", "packages", "left_out"),
    [
        ("wrongturn-client", "wrongturn_protocol,wrongturn_client", ()),
        ("wrongturn-openenv", "wrongturn_openenv", ()),
        ("wrongturn-networks", "wrongturn_networks", ()),
        ("wrongturn-service", "wrongturn_judge,wrongturn_sim", ()),
        ("wrongturn-service[server]", "wrongturn_service,wrongturn_runner,wrongturn_sandbox", ()),
        (
            "wrongturn-agents",
            "wrongturn_agents",
            tuple(f"wrongturn_agents.{name}" for name in ("batch", "models", "training")),
        ),
    ],
)
def test_each_module_of_a_part_imports_with_what_it_asks_for(
    wheels: Wheels, tmp_path: Path, wanted: str, packages: str, left_out: tuple[str, ...]
) -> None:
    environment = wheels.install(tmp_path / "venv", wanted)
    done = environment.python("-c", IMPORT_ALL, packages, *left_out)
    assert done.returncode == 0, done.stderr


def test_the_client_works_alone(wheels: Wheels, tmp_path: Path) -> None:
    environment = wheels.install(tmp_path / "venv", "wrongturn")
    done = environment.wrongturn("doctor")
    assert (done.returncode, done.stderr) == (0, "")
    assert "All is well." in done.stdout
    assert "wrongturn-service   not installed" in done.stdout


def test_the_simulation_drives_without_a_service(wheels: Wheels, tmp_path: Path) -> None:
    environment = wheels.install(tmp_path / "venv", "wrongturn[sim]")
    done = environment.python("-c", DRIVE)
    assert done.stdout == "(60, 2)\n", done.stderr
    done = environment.wrongturn("serve")
    assert (done.returncode, done.stdout) == (1, "")
    advice = r"-m pip install -c dist/constraints.txt --find-links dist 'wrongturn-service\[server\]'"
    assert re.fullmatch(rf"serve: .*fastapi, .*: not installed; \S+ {advice}\n", done.stderr)


def test_agents_drive_without_torch(wheels: Wheels, tmp_path: Path) -> None:
    environment = wheels.install(tmp_path / "venv", "wrongturn-agents[onnx]")
    done = environment.python("-c", ACT, "careful", "ppo-segmentation")
    assert done.stdout == "Action\nAction\n", done.stderr


def test_a_run_without_a_service_says_what_to_install(wheels: Wheels, tmp_path: Path) -> None:
    environment = wheels.install(tmp_path / "venv", "wrongturn[agents]")
    done = environment.wrongturn("run", "careful", "--suite", "smoke@3")
    assert done.returncode == 1
    assert "--find-links dist wrongturn-networks. To run agents without a --url: " in done.stderr
    assert "--find-links dist wrongturn-networks 'wrongturn-service[server]'" in done.stderr
    environment = wheels.install(tmp_path / "with-sim", "wrongturn[agents,sim]")
    done = environment.wrongturn("run", "careful", "--suite", "smoke@3")
    assert done.returncode == 1
    assert "--find-links dist 'wrongturn-service[server]'\n" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize(
    ("wanted", "command"),
    [
        ("wrongturn", ["--version"]),
        ("wrongturn-networks", ["towns"]),
        ("wrongturn[sim]", ["doctor"]),
        ("wrongturn[service]", ["doctor"]),
        ("wrongturn[agents,service]", ["run", "careful", "--suite", "smoke@3"]),
    ],
)
def test_a_wheel_installs_into_a_clean_environment_and_works(
    all_wheels: Wheels, tmp_path: Path, wanted: str, command: list[str]
) -> None:
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv/bin/python"
    install = [python, "-m", "pip", "install", "-c", all_wheels.folder / "constraints.txt"]
    subprocess.run([*install, "--find-links", all_wheels.folder, wanted], check=True, capture_output=True)
    subprocess.run([python, "-m", "pip", "check"], check=True, capture_output=True)
    done = subprocess.run(
        [tmp_path / "venv/bin/wrongturn", *command], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
