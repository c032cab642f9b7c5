"""Batches on a Ray cluster of this machine."""

from pathlib import Path

import pytest
from test_batch import batch, here  # noqa: F401 - a fixture


@pytest.mark.soak
def test_a_cluster_gives_what_processes_give(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    monkeypatch.setenv("RAY_ADDRESS", "local")
    assert batch("Single", "single.json").returncode == 0
    cluster = batch("Batched", "batched.json", "--ray")
    assert cluster.returncode == 0, cluster.stderr
    assert (here / "single.json").read_bytes() == (here / "batched.json").read_bytes()
    assert max(map(int, (here / "sizes").read_text().split())) > 1


def test_an_address_where_nobody_answers_is_named(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:  # noqa: F811
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")
    assert "--ray: RAY_ADDRESS: nobody answers at '127.0.0.1:1'" in batch("Single", "a.json", "--ray").stderr
