import json

import pytest
from small_run import SMALL

from wrongturn_agents.training import job as module
from wrongturn_agents.training.campaign_plan import Job
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.lock import locked
from wrongturn_agents.training.progress_file import read_rows

JOB = Job(algorithm="ppo-segmentation", seed=2, steps=24, options=(*SMALL, "evaluate_every=12"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    found = tmp_path / "jobs" / JOB.name
    found.mkdir(parents=True)
    told = {"job": JOB.as_dict(), "suites": ["smoke@1"], "bundle": str(tmp_path / "bundle"), "device": "cpu"}
    (found / "job.json").write_text(json.dumps({**told, "threads": 1}))
    monkeypatch.setattr(module, "score", lambda *_, **__: {"trials": {}, "seed": JOB.seed})
    return found


def test_a_job_that_was_interrupted_goes_on(folder, tmp_path, monkeypatch):
    real = module.train

    def interrupted(*arguments, **options):
        real(*arguments, **{**options, "steps": 12})
        content = json.loads((folder / "run" / "config.json").read_text())
        (folder / "run" / "config.json").write_text(json.dumps({**content, "steps": 24}))
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "train", interrupted)
    with pytest.raises(KeyboardInterrupt):
        module.run(folder)
    assert not (folder / module.DONE).exists()
    monkeypatch.setattr(module, "train", real)
    module.run(folder)
    assert (folder / module.DONE).is_file()
    assert [int(row["step"]) for row in read_rows(folder / "run" / "progress.csv")] == [12, 24]
    bundle = tmp_path / "bundle"
    assert json.loads((bundle / "results" / f"{JOB.name}.smoke@1.json").read_text())["seed"] == 2
    assert (bundle / "runs" / JOB.name / "progress.csv").is_file()
    assert json.loads((bundle / "weights" / "ppo-segmentation.json").read_text())["seed"] == 2
    monkeypatch.setattr(module, "train", interrupted)
    module.run(folder)  # what is done is not done again


def test_a_run_that_was_interrupted_before_it_could_go_on_begins_anew(folder, monkeypatch):
    begun = []
    (folder / "run").mkdir()
    (folder / "run" / "config.json").write_text("{}")
    (folder / "run" / "encoder.pt").write_bytes(b"pretrained")

    def train(algorithm, **options):
        begun.append((options.get("resume", False), list(options["options"])))
        assert not (folder / "run").exists()
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "train", train)
    with pytest.raises(KeyboardInterrupt):
        module.run(folder)
    assert begun == [(False, [*JOB.options, f"encoder={folder / 'encoder.pt'}"])]


def test_two_processes_are_not_at_the_same_job(folder):
    with locked(folder / ".lock", "busy"), pytest.raises(TrainingError, match="another process"):
        module.run(folder)
