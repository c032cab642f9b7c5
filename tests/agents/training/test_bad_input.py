"""What a user can get wrong at the command line: one line that names it and the remedy, status 1, and nothing lost."""

import json

import pytest
import torch
from small_run import SMALL, settings_of
from typer.testing import CliRunner

from wrongturn_agents.errors import AgentsError
from wrongturn_agents.models import build
from wrongturn_agents.training.checkpoint import save_checkpoint
from wrongturn_client.cli import app
from wrongturn_protocol.json_output import JsonFileError

SEGMENTATION = "ppo-segmentation"
pytestmark = pytest.mark.usefixtures("small_networks")


def refused(*arguments):
    """What the program says of arguments that it refuses. Whatever is no error of its own is a bug's traceback."""
    done = CliRunner().invoke(app, [str(argument) for argument in arguments])
    if isinstance(done.exception, SystemExit):
        assert done.exit_code == 2, done.output  # the parser's
        return done.output
    assert isinstance(done.exception, AgentsError | JsonFileError), done.output or repr(done.exception)
    said = str(done.exception)
    assert "\n" not in said
    assert len(said) < 700
    return said


def saved(path, **changes):
    """A checkpoint of an untrained agent, with some of it changed."""
    config = settings_of(SEGMENTATION)
    save_checkpoint(path, build(SEGMENTATION, seed=1), config, seed=1, steps=5, evaluation={})
    if changes:
        torch.save(torch.load(path, weights_only=True) | changes, path)
    return path


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    return saved(tmp_path_factory.mktemp("run") / "best.pt")


@pytest.fixture
def run(tmp_path):
    """A directory as a run of seed 3 leaves it, but for its weights."""
    folder = tmp_path / "run"
    folder.mkdir()
    config = settings_of(SEGMENTATION, *SMALL)
    content = {"algorithm": SEGMENTATION, "seed": 3, "steps": 24, "minutes": None, "config": config.as_dict()}
    (folder / "config.json").write_text(json.dumps(content))
    torch.save({"steps": 12}, folder / "state.pt")
    return folder


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--seed", "-1"], "seed"),
        (["--minutes", "nan"], "minutes"),
        (["--steps", "0"], "steps"),
        (["--threads", "0"], "threads"),
        (["--num-envs", "0"], "num-envs"),
        (["--num-envs", "100000000"], "num_envs"),
        (["--device", "tpu"], "device"),
        (["--teacher", "privileged.pt"], "teacher"),
        (["--option", "n_steps=" + "9" * 5000], "n_steps"),
    ],
)
def test_settings_that_cannot_be_make_no_directory(tmp_path, arguments, named):
    said = refused("train", SEGMENTATION, "--directory", tmp_path / "run", *arguments)
    assert named in said
    assert not (tmp_path / "run").exists()


def test_an_encoder_that_is_none_makes_no_directory(tmp_path):
    (tmp_path / "text.pt").write_text("no encoder")
    torch.save({"a": 1}, tmp_path / "other.pt")
    torch.save({"state_dict": {"mask": torch.ones(1)}}, tmp_path / "agent.pt")
    wrong = {"missing.pt": "no such file", "text.pt": "damaged", "other.pt": "no encoder", "agent.pt": "no encoder"}
    for name, why in wrong.items():
        said = refused("train", "marln", "--directory", tmp_path / "run", "--option", f"encoder={tmp_path / name}")
        assert "option encoder" in said
        assert why in said
        assert not (tmp_path / "run").exists()


def test_a_directory_that_cannot_be_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    for directory in (tmp_path / "file", tmp_path / "file" / "run", tmp_path / ("x" * 300), "/proc/run"):
        assert "cannot be written" in refused("train", SEGMENTATION, "--steps", 1, "--directory", directory)


def test_a_run_is_never_written_over(run, tmp_path, checkpoint):
    assert "--resume" in refused("train", SEGMENTATION, "--directory", run)
    weights = tmp_path / "weights"
    weights.mkdir()
    (weights / "best.pt").write_bytes(checkpoint.read_bytes())
    assert "best.pt" in refused("train", SEGMENTATION, "--directory", weights)
    assert (weights / "best.pt").read_bytes() == checkpoint.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (["--seed", "7"], "leave --seed out"),
        (["--option", "gamma=0.5"], "give none"),
        (["--num-envs", "4"], "give none"),
    ],
)
def test_what_a_run_has_of_its_own_is_not_given_anew(run, arguments, remedy):
    before = {path.name: path.read_bytes() for path in run.iterdir()}
    assert remedy in refused("train", SEGMENTATION, "--directory", run, "--resume", *arguments)
    assert {path.name: path.read_bytes() for path in run.iterdir()} == before


def test_a_run_that_cannot_be_resumed_says_why(run, tmp_path):
    def resumed(algorithm=SEGMENTATION):
        return refused("train", algorithm, "--directory", run, "--resume", "--seed", 3)

    assert "no run to resume" in refused("train", SEGMENTATION, "--directory", tmp_path / "none", "--resume")
    assert not (tmp_path / "none").exists()
    for other in ("ppo-image", "lbc", "marln"):
        assert f"holds a run of {SEGMENTATION}; resume it with 'wrongturn train {SEGMENTATION}'" in resumed(other)
    assert "damaged" in resumed()
    (run / "state.pt").write_bytes(b"half of a fi")
    assert "damaged" in resumed()
    (run / "state.pt").unlink()
    assert "without --resume" in resumed()
    content = json.loads((run / "config.json").read_text())
    (run / "config.json").write_text(json.dumps({**content, "config": {"vehicles": 500}}))
    assert "option vehicles: is 500; give a number from 0 to 200" in resumed()
    for text in ("{", "[]", '{"algorithm": "ppo-segmentation"}', '{"algorithm": 5, "config": {}}', "\x00"):
        (run / "config.json").write_text(text)
        assert "config.json" in resumed()


def test_a_run_that_failed_at_once_is_begun_anew(run):
    (run / "state.pt").unlink()
    options = [word for option in SMALL for word in ("--option", option)]
    command = ["train", SEGMENTATION, "--directory", run, "--seed", 4, "--steps", 12, "--threads", 1, "--device", "cpu"]
    done = CliRunner().invoke(app, [str(word) for word in (*command, *options)])
    assert done.exit_code == 0, done.output
    assert json.loads((run / "config.json").read_text())["seed"] == 4
    assert (run / "best.pt").is_file()


def broken_checkpoints(folder):
    text, archive, cut = (folder / name for name in ("text.pt", "archive.pt", "cut.pt"))
    text.write_text("I am no checkpoint.\n")
    archive.write_bytes(b"PK\x05\x06" + bytes(18))
    whole = saved(folder / "whole.pt").read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    (folder / "empty.pt").touch()
    torch.save([1, 2], folder / "list.pt")
    torch.save({"state_dict": {}}, folder / "foreign.pt")
    saved(folder / "algorithm.pt", algorithm="dqn")
    saved(folder / "odd.pt", algorithm=5)
    saved(folder / "field.pt", config={"colour": 3})
    saved(folder / "value.pt", config={"gamma": "much"})
    saved(folder / "weights.pt", state_dict={"encoder.mask": 5})
    saved(folder / "others.pt", state_dict=build("ppo-image", seed=1).state_dict())
    bad = build(SEGMENTATION, seed=1).state_dict()
    bad["log_std"][0] = float("nan")
    saved(folder / "nan.pt", state_dict=bad)
    (folder / "folder.pt").mkdir()
    return [*sorted(path for path in folder.iterdir() if path.name != "whole.pt"), folder / "missing.pt"]


def test_checkpoints_that_are_none_are_named(tmp_path):
    for path in broken_checkpoints(tmp_path):
        for command in (["score", path], ["export", path, tmp_path / "made.onnx"]):
            said = refused(*command)
            assert said.startswith("checkpoint"), f"{path.name}: {said}"
            assert any(word in said for word in ("name ", "train it anew", "choose one", "give a", "install")), said
        said = refused("train", "lbc", "--directory", tmp_path / "run", "--teacher", path)
        assert said.startswith("teacher"), f"{path.name}: {said}"
        assert "name the privileged.pt of a run of lbc" in said
        assert "Invalid argument" not in said
    assert not (tmp_path / "made.onnx").exists()
    assert not (tmp_path / "run").exists()


def test_a_misspelt_agent_is_told_the_agents(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ppo-auxilary").mkdir()
    assert "Did you mean ppo-auxiliary?" in refused("score", "ppo-auxilary")
    assert refused("score", "ppo-image", "--device", "gpu").startswith("device: is 'gpu'")
    for name in ("", ".", "a" * 300, "missing.zip"):
        assert refused("score", name).startswith("agent:"), name
    assert refused("score", tmp_path / "ppo-auxilary").startswith("checkpoint")


def test_what_cannot_be_scored_or_exported_is_told_before_anything_is_done(tmp_path, checkpoint):
    (tmp_path / "file").write_text("")
    assert "--json" in refused("score", checkpoint, f"--json={tmp_path}")
    assert "--json" in refused("score", checkpoint, "--json", tmp_path / "file" / "a.json")
    assert "batch" in refused("score", checkpoint, "--batch", 0)
    assert "device" in refused("score", checkpoint, "--device", "cuda:9")
    before = checkpoint.read_bytes()
    assert "FILE" in refused("export", checkpoint, checkpoint, "--no-compare")
    assert checkpoint.read_bytes() == before
    assert "--name" in refused("export", checkpoint, tmp_path / "a.onnx", "--name", "\n", "--no-compare")
    assert "is a shipped agent" in refused("export", "ppo-image", tmp_path / "a.onnx")
