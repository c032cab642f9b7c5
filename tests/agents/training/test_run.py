import json

import pytest
import torch
from small_run import HERE, SMALL

from wrongturn_agents.training.checkpoint import load_checkpoint, read
from wrongturn_agents.training.methods.ppo.ppo import WrongturnPPO
from wrongturn_agents.training.progress import read_rows
from wrongturn_agents.training.run import Run, train

FAST = [*SMALL, "evaluate_every=12"]


@pytest.fixture(scope="module")
def run(tmp_path_factory, small_networks):
    """A run of two updates, and one without traffic that was interrupted after one and goes on."""
    whole, halved = (tmp_path_factory.mktemp(name) for name in ("whole", "halved"))
    train("ppo-segmentation", directory=whole, seed=3, steps=24, **HERE, options=FAST)
    train("ppo-segmentation", directory=halved, seed=3, steps=12, **HERE, options=[*FAST, "traffic=0"])
    before = read(halved / "state.pt")
    train("ppo-segmentation", directory=halved, steps=24, **HERE, resume=True)
    return whole, halved, before


def test_a_run_leaves_its_files(run):
    whole = run[0]
    names = {path.name for path in whole.iterdir()}
    assert names == {"best.pt", "last.pt", "state.pt", "progress.csv", "config.json", "tensorboard"}
    content = json.loads((whole / "config.json").read_text())
    assert (content["algorithm"], content["seed"], content["config"]["num_envs"]) == ("ppo-segmentation", 3, 2)
    rows = read_rows(whole / "progress.csv")
    assert [int(row["step"]) for row in rows] == [12, 24]
    assert rows[0]["success_heldout"] == rows[0]["traffic_success_heldout"] == "0"


def test_a_resumed_run_goes_on(run):
    whole, halved, before = run
    after = read(halved / "state.pt")
    rows = read_rows(halved / "progress.csv")
    assert [int(row["step"]) for row in rows] == [12, 24]
    assert (before["steps"], after["steps"]) == (12, 24)
    # The optimiser's steps are counted on, so its moments were kept.
    counts = [max(entry["step"].item() for entry in state["optimizer"]["state"].values()) for state in (before, after)]
    assert counts[1] > counts[0] > 0
    assert after["updates"] > before["updates"]
    assert after["seconds"] > before["seconds"]
    # And the schedule is the whole run's.
    rates = [float(read_rows(directory / "progress.csv")[1]["learning_rate"]) for directory in (whole, halved)]
    assert rates[0] == pytest.approx(rates[1])


def test_it_begins_where_it_was_interrupted(run, tmp_path, monkeypatch):
    """Nothing is learnt where nothing is left: the weights come back as they were."""
    halved = run[1]
    state = read(halved / "state.pt")
    seen = {}

    def learn(self, *arguments, **options):
        seen["policy"] = {name: tensor.clone() for name, tensor in self.policy.state_dict().items()}
        seen["steps"], seen["remaining"] = self.num_timesteps, self._current_progress_remaining
        seen["random"] = torch.get_rng_state()

    monkeypatch.setattr(WrongturnPPO, "learn", learn)
    train("ppo-segmentation", directory=halved, steps=48, **HERE, resume=True)
    assert all(torch.equal(tensor, state["policy"][name]) for name, tensor in seen["policy"].items())
    assert torch.equal(seen["random"], state["torch"])
    assert (seen["steps"], seen["remaining"]) == (24, 0.5)


def test_without_traffic_no_journey_has_any(run):
    (row,) = read_rows(run[1] / "progress.csv")[-1:]
    assert (row["success_heldout"], row["traffic_success_heldout"]) == ("0", "")
    assert load_checkpoint(run[1] / "best.pt")["evaluation"]["traffic_success"] is None


def test_a_run_that_is_killed_while_it_first_saves_is_resumed(tmp_path, monkeypatch, small_networks):
    def killed(*_, **__):
        raise SystemExit

    monkeypatch.setattr(Run, "save", killed)
    with pytest.raises(SystemExit):
        train("ppo-segmentation", directory=tmp_path, steps=12, **HERE, options=[*FAST, "traffic=0"])
    monkeypatch.undo()
    train("ppo-segmentation", directory=tmp_path, steps=24, **HERE, resume=True)
    assert load_checkpoint(tmp_path / "best.pt")["steps"] > 0
