"""Several runs by one command, each a program of its own: most are of a method that only counts."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from counting_method import counting, program_of, trained, until  # noqa: F401 - a fixture
from small_run import HERE, SMALL

from wrongturn_agents.training.checkpoint import load_checkpoint, read
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.progress import read_rows
from wrongturn_agents.training.run import train

pytestmark = pytest.mark.usefixtures("counting")


def test_two_seeds_side_by_side_learn_what_they_learn_alone():
    options = [*SMALL, "traffic=0"]
    words = [word for option in options for word in ("--option", option)]
    done = trained("ppo-segmentation", "--seeds", "2-3", "--steps", 12, "--threads", 1, "--device", "cpu", *words)
    assert done.exit_code == 0, done.output or done.exception
    train("ppo-segmentation", directory=Path("alone"), seed=3, steps=12, **HERE, options=options)
    alone, *others = (load_checkpoint(Path(name, "last.pt"))["state_dict"] for name in
                      ("alone", "runs/ppo-segmentation-3", "runs/ppo-segmentation-2"))  # fmt: skip
    same = [all(torch.equal(alone[name], weights[name]) for name in alone) for weights in others]
    assert same == [True, False]
    assert "100%, " in Path("runs/ppo-segmentation-2/log.txt").read_text()


@pytest.mark.soak
def test_one_that_fails_or_is_killed_ends_no_other_and_all_resume():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job of a shell would ignore Ctrl-C
    words = ["counting", "--seeds", "1-3", "--option", "counting.bad=3", "--steps", "1000000"]
    parent = subprocess.Popen(
        [sys.executable, "-m", "wrongturn_client", "train", *words], stdout=subprocess.PIPE, text=True
    )
    states = [f"runs/counting-{seed}/state.pt" for seed in (1, 2)]
    try:
        until(lambda: parent.poll() is not None or all(map(os.path.isfile, states)))
        os.kill(program_of("counting-1"), signal.SIGKILL)
        said = {parent.stdout.readline().strip() for _ in range(2)}
        assert said == {
            "counting-1: failed: ended by SIGKILL",
            "counting-3: failed: wrongturn: option bad: is this seed",
        }
        parent.send_signal(signal.SIGINT)
        assert "counting-2: stopped" in parent.communicate(timeout=60)[0]
        assert parent.returncode == 130
    finally:
        parent.kill()
    saved = read(Path("runs/counting-2/state.pt"))["count"]
    assert saved == int(read_rows(Path("runs/counting-2/progress.csv"))[-1]["step"]) > 1

    words[-1] = str(saved + 5)
    refused = trained(*words)
    assert "holds a run already" in str(refused.exception)
    done = trained(*words, "--resume")
    assert isinstance(done.exception, TrainingError)
    assert "1 of 3 runs failed" in str(done.exception)
    assert "counting-3 (runs/counting-3/log.txt)" in str(done.exception)
    for seed in (1, 2):
        rows = read_rows(Path(f"runs/counting-{seed}/progress.csv"))
        assert [int(row["step"]) for row in rows] == [*range(1, saved + 6)]

    words[words.index("1-3")] = "1,2"
    again = trained(*words, "--resume")
    assert again.exit_code == 0, again.exception
    assert again.output.splitlines()[:2] == ["counting-1: has finished", "counting-2: has finished"]
    other = trained(*words, "--option", "bad=5", "--resume")
    assert "counting-1: its run has other options" in str(other.exception)


@pytest.mark.parametrize(
    ("words", "named"),
    [
        *((["--seeds", text], "seeds") for text in ("", "x", "1-", "-1", "3-1", "1,1-2", "0-99999", "1;2")),
        (["--seeds", "1-2", "--seed", "1"], "--seed is given too"),
        (["--seeds", "4294967296"], "seed"),
        (["--seeds", "1-2", "--gpus", "1"], "--ray"),
        (["--gpus", "1"], "--ray"),
        (["--seeds", "1-2", "--steps", "0"], "steps"),
        (["--seeds", "1-2", "--minutes", "nan"], "minutes"),
        (["--seeds", "1-2", "--device", "tpu"], "device"),
        (["--seeds", "1-2", "--option", "lbc.rounds=0"], "lbc.rounds"),
        (["counting"], "named twice"),
    ],
)
def test_what_cannot_be_begins_no_run(words, named):
    done = trained("counting", *words)
    said = str(done.exception) + done.output
    assert done.exit_code != 0
    assert named in said
    assert not Path("runs").exists()
