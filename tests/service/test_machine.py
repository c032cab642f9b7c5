"""What a machine or a container gives the service, as the kernel tells it."""

import os
from pathlib import Path

import pytest

from wrongturn_service.machine import Machine

MIB = 1 << 20
PROC = "MemTotal:       16777216 kB\nMemFree:  1 kB\nMemAvailable:    8388608 kB\n"


def machine(folder: Path, cgroup: str, files: dict[str, str]) -> Machine:
    """A machine of 16 GiB with these files of its cgroups."""
    (folder / "proc/self").mkdir(parents=True)
    (folder / "proc/meminfo").write_text(PROC)
    (folder / "proc/self/cgroup").write_text(cgroup)
    for name, text in files.items():
        file = folder / "cgroup" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text + "\n")
    return Machine(folder / "proc", folder / "cgroup")


@pytest.fixture(autouse=True)
def _eight_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))


def test_without_limits_it_is_the_whole_machine(tmp_path: Path) -> None:
    whole = machine(tmp_path, "0::/user.slice\n", {"user.slice/memory.max": "max", "user.slice/cpu.max": "max 100000"})
    assert whole.memory() == 16384 * MIB
    assert whole.available_memory() == 8192 * MIB
    assert whole.processors() == 8
    assert whole.simulators() == 32


def test_a_kernel_that_tells_nothing(tmp_path: Path) -> None:
    silent = Machine(tmp_path, tmp_path)
    assert (silent.memory(), silent.available_memory(), silent.processors(), silent.simulators()) == (0, 0, 8, 32)
    assert silent.gateway() is None


def test_the_limits_of_a_container(tmp_path: Path) -> None:
    files = {
        "memory.max": str(4096 * MIB),
        "memory.current": str(1000 * MIB),
        "memory.stat": f"anon 1\ninactive_file {200 * MIB}\nactive_file 7",
        "cpu.max": "250000 100000",
    }
    container = machine(tmp_path, "0::/\n", files)
    assert container.memory() == 4096 * MIB
    assert container.available_memory() == (4096 - 800) * MIB
    assert container.processors() == 2
    # 4 GiB less 1 for the service, 200 MiB each, one of them the spare.
    assert container.simulators() == 14
    assert container.simulators(sandboxes=4) == 9  # 256 MiB each


def test_the_least_limit_of_all_groups_above_counts(tmp_path: Path) -> None:
    files = {
        "a/memory.max": str(2048 * MIB),
        "a/memory.current": str(3000 * MIB),
        "a/b/memory.max": str(3072 * MIB),
        "a/b/memory.current": "0",
        "a/cpu.max": "max 100000",
        "a/b/cpu.max": "50000 100000",
    }
    inner = machine(tmp_path, "0::/a/b\n", files)
    assert inner.memory() == 2048 * MIB
    assert inner.available_memory() == 1  # more is used than the limit allows, which is not the same as unknown
    assert inner.processors() == 1
    assert inner.simulators() == 4


def test_the_default_gateway(tmp_path: Path) -> None:
    found = machine(tmp_path, "", {})
    (tmp_path / "proc/net").mkdir()
    (tmp_path / "proc/net/route").write_text(
        "Iface\tDestination\tGateway \tFlags\tRefCnt\tUse\tMetric\tMask\t\tMTU\tWindow\tIRTT\n"
        "eth1\t000014AC\t00000000\t0001\t0\t0\t0\t0000FFFF\t0\t0\t0\n"
        "eth0\t00000000\t010015AC\t0003\t0\t0\t0\t00000000\t0\t0\t0\n"
    )
    assert found.gateway() == "172.21.0.1"
