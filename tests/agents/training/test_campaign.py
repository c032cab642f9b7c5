"""Campaigns of jobs that only pretend, and one of a real one."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
from small_run import SMALL

from wrongturn_agents.training import campaign as module
from wrongturn_agents.training import campaign_jobs
from wrongturn_agents.training.bundle import join
from wrongturn_agents.training.campaign import Campaign, devices_of, watch
from wrongturn_agents.training.campaign_plan import Job, Plan
from wrongturn_agents.training.checkpoint import load_checkpoint, model_of, read
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.job import rank
from wrongturn_agents.training.progress_file import read_rows

PRETENDED = """
import os, sys, time, pathlib
folder = pathlib.Path(sys.argv[1])
(folder / "device").write_text(os.environ.get("CUDA_VISIBLE_DEVICES", "none"))
exec((folder.parent.parent / (folder.name + ".py")).read_text())
"""
DONE = "(folder / 'done.json').write_text('{}')"


@pytest.fixture
def pretend(tmp_path, monkeypatch):
    """Jobs run what they are told here by name; the others are done at once."""

    def start(name, arguments, log, more):
        return subprocess.Popen([sys.executable, "-c", PRETENDED, *arguments], env={**os.environ, **more}, stderr=log)

    monkeypatch.setattr(campaign_jobs, "_module", start)
    monkeypatch.setattr(module, "_EVERY", 0.1)

    def run(jobs, devices=(), minutes=10.0, **scripts):
        for job in jobs:
            (tmp_path / f"{job.name}.py").write_text(scripts.get(f"s{job.seed}", DONE))
        return Campaign(Plan(jobs=tuple(jobs)), tmp_path, list(devices), minutes)

    return run


def job(seed, **more):
    return Job(algorithm="ppo-segmentation", seed=seed, minutes=1.0, **more)


def said(tmp_path):
    return (tmp_path / "campaign.log").read_text()


def test_jobs_share_the_gpus_by_their_slots(pretend, tmp_path):
    jobs = [job(1), job(2, slots=2), job(3), job(4), job(5, slots=2)]
    wait = f"time.sleep(1.5); {DONE}"
    campaign = pretend(jobs, devices=("2", "5"), s1=wait, s2=wait, s3=wait, s4=wait)
    assert campaign.run(warm=False)
    devices = [(tmp_path / "jobs" / one.name / "device").read_text() for one in jobs]
    assert devices[:4] == ["2", "5", "2", "2"]
    lines = said(tmp_path)
    assert lines.index("s5: begins") > lines.index(": done after")
    status = json.loads((tmp_path / "status.json").read_text())
    assert status["over"]
    assert {told["state"] for told in status["jobs"].values()} == {"done"}


def test_a_job_that_fails_is_tried_once_more(pretend, tmp_path):
    count = "p = folder / 'n'; p.write_text(p.read_text() + 'x' if p.exists() else 'x'); "
    campaign = pretend(
        [job(1), job(2), job(3)],
        s1=count + "sys.exit(3)",
        s2=count + "sys.exit(3 if len(p.read_text()) < 2 else " + "((folder / 'done.json').write_text('{}'), 0)[1])",
    )
    assert not campaign.run(warm=False)
    assert (tmp_path / "jobs" / "ppo-segmentation.s1" / "n").read_text() == "xx"
    assert [one.state for one in campaign.jobs] == ["failed", "done", "done"]


def test_what_would_not_be_over_in_time_is_not_begun(pretend, tmp_path):
    campaign = pretend([job(1)], minutes=2.5)
    assert not campaign.run(warm=False)
    assert "begins" not in said(tmp_path)
    assert campaign.jobs[0].state == "waiting"


def test_what_runs_at_the_end_is_stopped(pretend, tmp_path):
    campaign = pretend([job(1)], minutes=10.0, s1="time.sleep(60)")
    campaign._say("begins")
    campaign._step()
    campaign.end = time.monotonic() + 10.0
    begin = time.monotonic()
    assert not campaign.run(warm=False)
    assert time.monotonic() - begin < 5.0
    assert "stopped ppo-segmentation.s1" in said(tmp_path)


def test_done_jobs_are_not_done_again(pretend, tmp_path):
    assert pretend([job(1), job(2)]).run(warm=False)
    again = pretend([job(1), job(2)], s1="sys.exit(1)", s2="sys.exit(1)")
    assert again.run(warm=False)
    assert "2 of them done" in said(tmp_path)


def test_watching(tmp_path, capsys, pretend):
    assert not watch(tmp_path, 0.0)
    pretend([job(1)]).run(warm=False)
    assert watch(tmp_path, 5.0)
    assert "done     ppo-segmentation.s1" in capsys.readouterr().out


def test_gpus_that_are_not_there():
    with pytest.raises(TrainingError, match="gpus"):
        devices_of("99")
    with pytest.raises(TrainingError, match="gpus"):
        devices_of("all")
    assert devices_of("0") == []


def test_success_goes_before_reward():
    assert rank({"success": 0.9, "reward": 1.0}) > rank({"success": 0.8, "reward": 9.0}) > rank({})
    assert rank({"success": 1.0, "journeys": 50, "reward": 1.0}) > rank({"success": 1.0, "journeys": 20, "reward": 9.0})


PLAN = f"""
suites = ["smoke@1"]
[[jobs]]
algorithm = "ppo-segmentation"
steps = 1_000_000
options = {json.dumps([*SMALL, "evaluate_every=24"])}
"""


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_campaign_is_interrupted_and_goes_on(tmp_path):
    plan, directory = tmp_path / "plan.toml", tmp_path / "campaign"
    plan.write_text(PLAN)
    command = [sys.executable, "-m", "wrongturn_agents.training.campaign", str(plan), "--gpus", "0", "--minutes", "20"]
    command += ["--directory", str(directory)]
    run = directory / "jobs" / "ppo-segmentation.s1" / "run"
    process = subprocess.Popen(command)
    end = time.monotonic() + 600
    while not (run / "state.pt").is_file() and process.poll() is None and time.monotonic() < end:
        time.sleep(0.2)
    process.send_signal(signal.SIGTERM)
    process.wait(30)
    status = json.loads((directory / "status.json").read_text())
    assert [told["state"] for told in status["jobs"].values()] == ["waiting"]
    reached = read(run / "state.pt")["steps"]
    assert reached >= 24
    content = json.loads((run / "config.json").read_text())
    content["steps"] = reached + 12  # else it would go on for hours
    (run / "config.json").write_text(json.dumps(content))
    assert subprocess.run(command, check=False).returncode == 0
    assert int(read_rows(run / "progress.csv")[-1]["step"]) == reached + 12
    bundle = directory / "bundle"
    assert [path.name for path in (bundle / "results").iterdir()] == ["ppo-segmentation.s1.smoke@1.json"]
    assert (bundle / "runs" / "ppo-segmentation.s1" / "progress.csv").is_file()
    join(bundle / "weights" / "ppo-segmentation.json", tmp_path / "best.pt")
    assert model_of(load_checkpoint(tmp_path / "best.pt")).algorithm == "ppo-segmentation"
