import pytest
from small_run import SMALL, settings_of
from typer.testing import CliRunner

from wrongturn_agents.models import build
from wrongturn_agents.results_file import ResultsFile
from wrongturn_agents.training.checkpoint import save_checkpoint
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.score import score, summary
from wrongturn_client.cli import app
from wrongturn_networks import load_suite
from wrongturn_protocol import Verdict


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory, small_networks):
    path = tmp_path_factory.mktemp("run") / "best.pt"
    config = settings_of("ppo-segmentation", *SMALL, "masked_classes=0.3")
    save_checkpoint(path, build("ppo-segmentation", seed=5), config, seed=5, steps=24, evaluation={"success": 0.0})
    return path


def test_every_trial_of_a_suite_has_its_verdict(checkpoint):
    results = score(checkpoint, "smoke@3", device="cpu", threads=1)
    suite = load_suite("smoke@3")
    assert set(results["trials"]) == {trial.id for trial in suite.episodes}
    assert {found["verdict"] for found in results["trials"].values()} <= set(Verdict)
    assert (results["agent"], results["seed"], results["variant"]) == ("ppo-segmentation", 5, "masked-classes")
    assert (results["suite"], results["suite_sha256"]) == (suite.id, suite.sha256)
    assert results["secret"] == suite.id  # the open draw
    assert ResultsFile.model_validate(results).drawn.trials == {trial.id: trial for trial in suite.episodes}
    assert (results["driven"], results["steps"], results["device"]) == ("in process", 24, "cpu")
    assert any(line.startswith("Town01 infeasible: ") for line in summary(results))


def test_trials_with_others_are_estimated_apart_and_write_no_results(checkpoint, tmp_path):
    with pytest.raises(TrainingError, match=r"smoke@3 has no trials with other road users; leave --traffic out"):
        score(checkpoint, "smoke@3", device="cpu", threads=1, traffic=True)
    done = CliRunner().invoke(
        app, ["score", str(checkpoint), "--suite", "navigation@1", "--traffic", "--json", str(tmp_path / "no.json")]
    )
    assert done.exit_code != 0
    assert "an estimate beside simple traffic is no result" in str(done.exception) + done.output
    assert not (tmp_path / "no.json").exists()
