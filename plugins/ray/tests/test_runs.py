"""Runs on a Ray cluster of this machine."""

import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

from counting_method import counting, program_of, trained, until  # noqa: F401 - a fixture
from ray.cluster_utils import Cluster

from wrongturn_agents.training.checkpoint import read
from wrongturn_agents.training.progress import read_rows

pytestmark = pytest.mark.usefixtures("counting", "one_thread")
STATE = Path("runs/counting-1/state.pt")


@pytest.fixture
def cluster(counting, monkeypatch):  # noqa: F811 - its nodes find the method, too
    """A cluster of one node with two cores, which RAY_ADDRESS names."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder:  # sockets' paths are short
        monkeypatch.setenv("RAY_TMPDIR", folder)
        monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        made = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False})
        monkeypatch.setenv("RAY_ADDRESS", made.address)
        yield made
        made.shutdown()


def begun(*words):
    """The program that trains on the cluster, once its first run has saved."""
    program = [sys.executable, "-m", "wrongturn_client", "train", "counting", "--ray", "--threads", "1", *words]
    parent = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    until(lambda: parent.poll() is not None or STATE.is_file())
    return parent


def test_a_run_on_a_node_leaves_its_files_here(cluster):
    done = trained("counting", "--seeds", "4", "--ray", "--steps", 5)
    assert done.exit_code == 0, done.exception
    assert [row["step"] for row in read_rows(Path("runs/counting-4/progress.csv"))] == ["1", "2", "3", "4", "5"]
    assert [path.name for path in Path("runs").iterdir()] == ["counting-4"]


@pytest.mark.parametrize("address", ["127.0.0.1:1", "127.0.0.1:99999", pytest.param("nowhere", marks=pytest.mark.soak)])
def test_a_cluster_that_is_not_there_is_named(address, monkeypatch):
    monkeypatch.setenv("RAY_ADDRESS", address)
    assert f"no cluster at '{address}'" in str(trained("counting", "--ray").exception)
    assert not Path("runs").exists()


@pytest.mark.soak
def test_a_run_whose_worker_dies_goes_on_and_one_that_fails_is_named(cluster):
    parent = begun("--seeds", "1-2", "--option", "bad=2", "--steps", "500")
    worker = int(Path(f"/proc/{program_of('counting-1')}/stat").read_text().rpartition(")")[2].split()[1])
    os.kill(worker, signal.SIGKILL)
    said = parent.communicate(timeout=300)[0]
    assert parent.returncode == 1
    assert "counting-2: failed: wrongturn: option bad: is this seed" in said
    assert "1 of 2 runs failed" in said
    assert [int(row["step"]) for row in read_rows(Path("runs/counting-1/progress.csv"))] == [*range(1, 501)]


@pytest.mark.soak
def test_ctrl_c_lets_runs_on_nodes_save(cluster):
    parent = begun("--seeds", "1-3", "--steps", "1000000")
    parent.send_signal(signal.SIGTERM)
    said = parent.communicate(timeout=300)[0]
    assert parent.returncode == 130
    assert said.count("stopped") == 3
    rows = read_rows(Path("runs/counting-1/progress.csv"))
    assert read(STATE)["count"] == int(rows[-1]["step"])
