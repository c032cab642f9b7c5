"""A guest that waits for its model has given up its rights, as the kernel sees it from outside."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from guest_processes import ListenerProcess, bubblewrap_and_guest
from upload_models import model

from wrongturn_sandbox import Limits, open_sandbox

MEMORY = 1 << 30


@pytest.fixture(scope="module", params=["bubblewrap", "listener"])
def guest(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[int]:
    """The process id of a guest that has loaded a model."""
    process = None
    if request.param == "bubblewrap":
        request.getfixturevalue("bubblewrap")
    else:
        process = ListenerProcess(tmp_path_factory.mktemp("run"))
    with open_sandbox(None if process is None else process.path, Limits(MEMORY, 60, 60)) as sandbox:
        sandbox.load(model())
        yield bubblewrap_and_guest()[1] if process is None else process.guests()[-1]
    if process is not None:
        process.end()


def status(pid: int) -> dict[str, str]:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}


def limits(pid: int) -> dict[str, tuple[str, str]]:
    lines = Path(f"/proc/{pid}/limits").read_text().splitlines()[1:]
    return {line[:25].strip(): (line[26:46].strip(), line[47:67].strip()) for line in lines}


def test_the_kernel_filters_its_calls_and_gives_it_no_new_rights(guest: int) -> None:
    found = status(guest)
    assert found["Seccomp"] == "2"
    assert found["NoNewPrivs"] == "1"
    assert found["Threads"] == "1"


@pytest.mark.parametrize("guest", ["bubblewrap"], indirect=True)
def test_under_bubblewrap_it_has_no_capabilities_and_namespaces_of_its_own(guest: int) -> None:
    found = status(guest)
    assert {found[name] for name in ("CapInh", "CapPrm", "CapEff", "CapBnd", "CapAmb")} == {"0" * 16}
    for name in ("cgroup", "ipc", "mnt", "net", "pid", "user", "uts"):
        assert Path(f"/proc/{guest}/ns/{name}").readlink() != Path(f"/proc/self/ns/{name}").readlink()


def test_its_limits_cannot_be_raised(guest: int) -> None:
    found = limits(guest)
    for name in ("Max core file size", "Max file size", "Max processes", "Max locked memory", "Max msgqueue size"):
        assert found[name] == ("0", "0")
    assert found["Max open files"] == ("16", "16")
    soft, hard = found["Max address space"]
    assert soft == hard
    assert MEMORY < int(hard) < MEMORY + (1 << 30)
    soft, hard = map(int, found["Max cpu time"])
    assert soft <= hard < 1000
    assert int(Path(f"/proc/{guest}/oom_score_adj").read_text()) > 0


def test_it_has_four_open_files(guest: int) -> None:
    opened = [link.readlink() for link in Path(f"/proc/{guest}/fd").iterdir()]
    assert sorted(str(place).partition(":")[0] for place in opened) == ["/dev/null"] * 3 + ["socket"]
