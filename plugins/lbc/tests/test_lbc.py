"""A short training beats a random policy, leaves its files and resumes; its file drives alike."""

import shutil
from pathlib import Path

import pytest
import torch
from metres_driven import CARS, alike, by_chance, metres
from small_run import HERE

from wrongturn_agents import resolve
from wrongturn_agents.models.waypoint_control import MEMORY
from wrongturn_agents.models.waypoints import to_picture
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.export.export import export
from wrongturn_agents.training.method import load
from wrongturn_agents.training.methods.averaging import Pool
from wrongturn_agents.training.progress import read_rows
from wrongturn_agents.training.recording import record_observations
from wrongturn_agents.training.run import train
from wrongturn_agents.training.run_directory import BEST
from wrongturn_lbc.cars import Cars
from wrongturn_lbc.config import LBCConfig
from wrongturn_lbc.expert import plan
from wrongturn_lbc.halves import PRIVILEGED_FILE, picture_loss, round_of, taught

SMALL = (
    *("width=8", "num_envs=16", "begin=256", "buffer=4096", "batch_size=32", "traffic=0", "warm_up=10"),
    *("average=0.9", "learning_rate=2e-3", "rounds=2", "journeys=1", "brief_journeys=1", "evaluations=1"),
    *("patience=3", "augment=false", "privileged_samples=768", "uses=8", "time_limit=15"),
)
SAMPLES = 896


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, small_lbc: None) -> Path:
    folder = tmp_path_factory.mktemp("lbc")
    train("lbc", directory=folder, seed=1, steps=SAMPLES, options=SMALL, **HERE)
    return folder


def test_a_short_training_beats_a_random_policy(run):
    chance = metres(by_chance())
    files = {PRIVILEGED_FILE: ("lbc-privileged", "privileged.csv", 2.0), BEST: ("lbc", "progress.csv", 1.5)}
    for file, (name, curve, better) in files.items():
        found = load(run / file)
        assert (found.agent.name, found.told["seed"], found.told["evaluation"]["journeys"]) == (name, 1, 1)
        model = found.model
        assert metres(model.drive_on, torch.zeros(CARS, MEMORY), pictures="rgb" in model.keys) > better * chance
        rows = read_rows(run / curve)
        losses = [float(row["loss"]) for row in rows]
        assert losses[-1] < 0.7 * losses[0]
        assert rows[-1]["success_heldout"] != ""
    assert found.told["steps"] == SAMPLES


@pytest.mark.soak  # a training of its own
def test_the_privileged_agent_is_evaluated_after_its_own_minutes(tmp_path):
    options = (*SMALL, "begin=64", "privileged_share=1e-7")  # less than a millisecond of the hour
    train("lbc", directory=tmp_path, steps=32, minutes=60, options=options, **HERE)
    assert load(tmp_path / PRIVILEGED_FILE).told["evaluation"]["journeys"] == 1


def test_a_run_resumes_where_it_stopped(run, tmp_path):
    folder, more = tmp_path / "run", SAMPLES + 64
    shutil.copytree(run, folder)
    train("lbc", directory=folder, steps=more, resume=True, **HERE)
    steps = [int(row["step"]) for row in read_rows(folder / "progress.csv")]
    assert steps == sorted(steps)
    assert steps[-1] == more
    rows, kept = read_rows(folder / "progress.csv"), load(folder / BEST).told
    assert kept["steps"] == more
    train("lbc", directory=folder, minutes=1e-3, resume=True, **HERE)  # they are used up
    assert read_rows(folder / "progress.csv") == rows
    assert load(folder / BEST).told["evaluation"] == kept["evaluation"]


def test_minutes_that_are_over_before_an_agent_learns_are_an_error(run, tmp_path):
    with pytest.raises(TrainingError, match="over before lbc-privileged learned anything; begin again with"):
        train("lbc", directory=tmp_path / "both", minutes=1e-3, options=SMALL, **HERE)
    folder, options = tmp_path / "student", (*SMALL, f"teacher={run / PRIVILEGED_FILE}")
    with pytest.raises(TrainingError, match="over before lbc learned anything; give --resume"):
        train("lbc", directory=folder, minutes=1e-3, options=options, **HERE)
    assert load(train("lbc", directory=folder, steps=32, minutes=60, resume=True, **HERE)).told["steps"] == 32


@pytest.mark.soak
def test_a_given_teacher_teaches_an_agent_of_another_width(run, tmp_path):
    """The run is interrupted in its last evaluation, and goes on."""

    def interrupt(row):
        if "success_heldout" in row:
            raise KeyboardInterrupt

    given, folder = run / PRIVILEGED_FILE, tmp_path / "run"
    options = (*SMALL, "begin=64", "width=16", f"teacher={given}")
    with pytest.raises(KeyboardInterrupt):
        train("lbc", directory=folder, steps=32, options=options, on_row=interrupt, **HERE)
    assert load(folder / BEST).told["evaluation"] == {}
    train("lbc", directory=folder, resume=True, **HERE)
    assert load(folder / BEST).told["evaluation"]["journeys"] == 1
    assert (folder / PRIVILEGED_FILE).read_bytes() == given.read_bytes()
    assert not (folder / "privileged.csv").exists()


@pytest.mark.parametrize("file", [BEST, pytest.param(PRIVILEGED_FILE, marks=pytest.mark.soak)])
def test_the_file_drives_as_the_checkpoint_does(run, file, tmp_path):
    exported = tmp_path / "agent.onnx"
    loaded = load(run / file)
    compared = record_observations(loaded.agent.track, 12, seed=4)
    found = export(run / file, exported, "fp16", compared=compared)
    assert found is not None
    assert found.observations == 12
    assert max(found.mean) <= max(found.greatest) < 5e-3
    source = resolve(str(exported))
    driver = source.make()
    assert (source.track, driver.memoryless) == ("privileged" if file == PRIVILEGED_FILE else "camera", False)
    assert alike(loaded.model, driver, {key: array[:6] for key, array in compared.items()}, 5e-3) == 6


def test_the_newest_samples_are_kept():
    samples = Pool(5)
    for begin in range(0, 9, 3):
        samples.add({"number": torch.arange(begin, begin + 3)})
    assert (len(samples), samples.added) == (5, 9)
    assert set(samples.draw(200)["number"].tolist()) == {4, 5, 6, 7, 8}


def test_rounds_begin_after_the_first_samples():
    config = LBCConfig(rounds=4, offline=0.2)
    assert [round_of(share, config) for share in (0.0, 0.19, 0.2, 0.39, 0.41, 0.99, 1.0)] == [0, 0, 1, 1, 2, 4, 4]
    assert round_of(0.9, LBCConfig(rounds=0)) == 0


def test_only_commands_with_weight_count():
    found, wanted = torch.zeros(2, 4, 5, 2), torch.zeros(2, 4, 5, 2)
    wanted[0, 0, :, 0] = 0.5  # 48 pixels to the side
    wanted[1, 2] = 1.0
    weights = torch.tensor([[1.0, 0, 0, 0], [0, 1.0, 0, 0]])
    assert picture_loss(found, wanted, weights).item() == pytest.approx(48.0 / 2 / 2)


class Told(torch.nn.Module):
    """Tells other waypoints for each command."""

    def forward(self, observation):
        places = torch.arange(1.0, 5.0).view(1, 4, 1, 1) * torch.tensor([2.0, 0.1])
        return places.expand(len(observation["speed"]), -1, 5, -1)


def test_groups_of_cars_move_on_to_other_towns():
    """Two groups in three towns; each moves after four decisions, in turn, and begins new drives there."""
    config = LBCConfig(traffic=0.0, inside_junctions=0.0, sceneries=2, groups=2, stay=4, cameras=True, weathers=True)
    cars = Cars(8, config, seed=1, pictures=True, device=torch.device("cpu"))
    keep = torch.tensor([[0.0, 0.3, 0.0]]).expand(8, -1)
    before, begun = cars.observe(), []
    for _ in range(4):
        begun.append(set(cars.step(keep).tolist()))
        assert {name: len(rows) for name, rows in cars.observe().items()} == dict.fromkeys(before, 8)
    assert begun[0] == begun[2] == set()
    assert begun[1] == {4, 5, 6, 7}
    assert begun[3] == {0, 1, 2, 3}
    assert cars.ended == ["timeout"] * 8
    assert plan(cars.situation(cars.observe())).shape == (8, 5, 2)
    cars.close()


def test_a_teacher_tells_all_commands_or_the_experts_for_one():
    cars = Cars(8, LBCConfig(traffic=0.0), seed=1, pictures=False, device=torch.device("cpu"))
    seen = cars.observe()
    waypoints, points, weights = taught(Told(), cars, seen, white_box=True)
    assert weights.tolist() == [[1.0] * 4] * 8
    assert torch.allclose(points, to_picture(Told()(seen)))
    assert torch.allclose(waypoints[:, 0, 0], 2.0 * seen["command"][:, 0])
    waypoints, points, weights = taught(Told(), cars, seen, white_box=False)
    assert weights.argmax(1).tolist() == (seen["command"][:, 0] - 1).tolist()
    assert weights.sum(1).tolist() == [1.0] * 8
    assert torch.allclose(points, to_picture(waypoints)[:, None].expand(-1, 4, -1, -1))
    cars.close()
