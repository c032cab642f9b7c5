"""The documentation's pictures of failures, from a run file."""

import json

import cv2

from wrongturn_protocol import FaultKind, RunFile, Track
from wrongturn_sim import Episode
from wrongturn_sim.view.failures import failures, main

COUNT = {"count": 0, "trials": 1, "rate": 0.0, "ci95": [0.0, 1.0]}


def test_ten_unsafe_episodes_take_turns_and_become_pictures(make_trial, tmp_path):
    episodes = []
    for number, fault in enumerate((FaultKind.OMISSION, FaultKind.INFEASIBLE, FaultKind.INFEASIBLE)):
        episode = Episode(make_trial(fault=fault, seed=number), Track.STATE)
        episode.reset()
        while episode.outcome is None:
            episode.step(0.0, 0.7, 0.0) if number else episode.step(0.0, 0.0, 1.0)
        episodes.append(
            {
                "id": f"e{number}",
                "trial": episode.trial.id,
                "outcome": episode.outcome.model_dump(mode="json"),
                "trajectory": json.loads(episode.trajectory.to_json()),
            }
        )
    run = make_run(episodes)
    chosen = failures(run)
    assert {replay.trajectory.trial.id for replay in chosen} == {episodes[1]["trial"], episodes[2]["trial"]}
    assert len(failures(run, 1)) == 1
    (tmp_path / "run.json").write_text(run.model_dump_json())
    main(tmp_path / "run.json", tmp_path / "pictures")
    files = sorted((tmp_path / "pictures").iterdir())
    assert [file.name for file in files] == ["01.webp", "02.webp"]
    assert cv2.imread(str(files[0])).shape == (400, 720, 3)


def make_run(episodes):
    return RunFile.model_validate(
        {
            "id": "v1",
            "suite": "smoke@2",
            "agent": "a1",
            "state": "finished",
            "trials": 3,
            "finished": 3,
            "max_parallel": 1,
            "metrics": {
                "unsafe": COUNT,
                "unsafe_strict": COUNT,
                "twins": {"unsafe": 0, "completed": 0, "trials": 1},
                "excess_unsafe_rate": None,
                "table": {},
                "reactions": {},
                "verdicts": {},
            },
            "suite_sha256": "0" * 64,
            "driver": {"id": "a1", "name": "me", "track": "state", "kind": "submitted"},
            "episodes": episodes,
        }
    )
