"""What README and its sisters say is there, is there."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    targets = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text("utf-8"))
    missing = [target for target in targets if "://" not in target and not (page.parent / target).exists()]
    assert not missing


def test_its_two_commands_can_be_run() -> None:
    first_block = (ROOT / "README.md").read_text("utf-8").split("```")[1]
    commands = [line.split()[0] for line in first_block.strip().splitlines()]
    assert commands == ["script/demo", "script/test"]
    for command in commands:
        assert (ROOT / command).stat().st_mode & 0o111
        subprocess.run(["bash", "-n", ROOT / command], check=True)


def test_setting_up_by_hand_is_what_the_scripts_do() -> None:
    shown = (ROOT / "CONTRIBUTING.md").read_text("utf-8").split("```")[1]
    script = (ROOT / "script/lib/setup.sh").read_text("utf-8")
    wanted = [
        *re.findall(r"pip (install --upgrade 'pip>=[\d.]+' setuptools)", script),
        *re.findall(r"pip (install -c constraints.txt torch)", script),
        *re.findall(r"wanted\+?=\((.+)\)", script),
    ]
    assert len(wanted) == 4
    places = [shown.find(options) for options in wanted]
    assert -1 not in places
    assert places == sorted(places)


def test_containers_need_nothing_installed_beside_them() -> None:
    blocks = (ROOT / "README.md").read_text("utf-8").split("```")[1::2]
    (containers,) = [block for block in blocks if "compose.yaml" in block]
    commands = [line.removeprefix("$ ").split()[0] for line in containers.splitlines()[1:]]
    assert set(commands) == {"docker", "docker/make-secrets"}
    assert "exec service wrongturn leaderboard" in containers


def test_it_can_be_read_in_a_few_minutes() -> None:
    prose = re.sub(r"^\|.*\n", "", (ROOT / "README.md").read_text("utf-8"), flags=re.MULTILINE)  # without tables
    assert len(prose.split()) <= 900


@pytest.mark.system
def test_its_figures_are_those_of_the_stored_results() -> None:
    checked = subprocess.run(
        [sys.executable, "-m", "lab.results", "--check"], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert checked.returncode == 0, checked.stderr
    told = checked.stdout.split(": ")[1].split(", ")
    assert {"README.md", "docs/failures.md", "docs/results.md", "docs/training.md"} <= {page.strip() for page in told}


MAP = re.findall(r"^\| .* \| `([\w/.]+)`.* \| `(\w+)` \|$", (ROOT / "ARCHITECTURE.md").read_text("utf-8"), re.MULTILINE)


@pytest.mark.parametrize(("path", "name"), MAP, ids=[path for path, _ in MAP])
def test_the_map_leads_to_what_it_names(path: str, name: str) -> None:
    assert re.search(rf"\b{name}\b", (ROOT / path).read_text("utf-8"))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_paths_and_modules_in_the_text_exist(page: Path) -> None:
    text = page.read_text("utf-8")
    paths = re.findall(r"`((?:agents|benchmarks|clients|docker|docs|networks|script|service|tests)/[\w./-]*)", text)
    made_by_commands = {"docker/.env", "docker/secrets", "docker/secrets/"}
    missing = [path for path in {*paths} - made_by_commands if not (ROOT / path).exists()]
    modules = re.findall(r"python -m (wrongturn_[\w.]+)", text)
    unknown = [module for module in modules if importlib.util.find_spec(module) is None]
    assert missing + unknown == []


@pytest.mark.parametrize(("length", "status"), [(1, 0), (71, 0), (72, 1)])
def test_a_long_subject_is_refused(tmp_path: Path, length: int, status: int) -> None:
    message = tmp_path / "message"
    message.write_text("ü" * length + "\n\n" + "body " * 40)
    done = subprocess.run([ROOT / "script/check-subject", message], env={"LC_ALL": "C.UTF-8"}, check=False)
    assert done.returncode == status
