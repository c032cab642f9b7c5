"""Short trainings: they leave their files, resume, and drive alike as a file. A longer one beats a random policy."""

import csv
import hashlib
import json
import shutil
from pathlib import Path

import pytest
import torch
from metres_driven import CARS, metres

from wrongturn_agents import resolve
from wrongturn_agents.models.waypoint_control import MEMORY
from wrongturn_agents.models.waypoints import to_picture
from wrongturn_agents.shipped_agents import SHIPPED_AGENTS
from wrongturn_agents.training.config import config_of
from wrongturn_agents.training.errors import TrainingError
from wrongturn_agents.training.lbc.cars import Cars
from wrongturn_agents.training.lbc.checkpoints import BEST, PRIVILEGED_FILE, is_lbc, load_agent
from wrongturn_agents.training.lbc.config import LBCConfig
from wrongturn_agents.training.lbc.exporting import export_lbc
from wrongturn_agents.training.lbc.learning import Samples
from wrongturn_agents.training.lbc.run import train
from wrongturn_agents.training.lbc.sensorimotor import Teacher, picture_loss, round_of
from wrongturn_agents.training.recording import record_observations
from wrongturn_agents.training.train import train as train_by_reward

SMALL = (
    *("width=8", "num_envs=16", "begin=64", "buffer=4096", "batch_size=32", "traffic=0", "warm_up=10"),
    *("average=0.9", "learning_rate=2e-3", "rounds=2", "journeys=1", "brief_journeys=1", "evaluations=1"),
    *("patience=3", "augment=false", "privileged_samples=128", "uses=4", "time_limit=15"),
)
SAMPLES = 192
ENOUGH = (*SMALL, "begin=256", "privileged_samples=768", "uses=8")
ENOUGH_SAMPLES = 896


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("lbc")
    train(directory=folder, seed=1, samples=SAMPLES, device="cpu", threads=1, options=SMALL)
    return folder


def rows_of(curve):
    with curve.open(newline="") as opened:
        return list(csv.DictReader(opened))


@pytest.mark.slow
def test_a_short_training_beats_a_random_policy(tmp_path):
    train(directory=tmp_path, seed=1, samples=ENOUGH_SAMPLES, device="cpu", threads=1, options=ENOUGH)
    random = torch.Generator().manual_seed(1)
    low = torch.tensor([-1.0, 0.0, 0.0])

    def by_chance(_, memory):
        return low + (1.0 - low) * torch.rand(CARS, 3, generator=random), memory

    chance = metres(by_chance)
    found = {}
    for file in (PRIVILEGED_FILE, BEST):
        agent, _ = load_agent(tmp_path / file)
        found[file] = metres(agent.drive_on, torch.zeros(CARS, MEMORY), pictures="rgb" in agent.keys)

    assert found[PRIVILEGED_FILE] > 2.0 * chance
    assert found[BEST] > 1.5 * chance
    for curve in ("privileged.csv", "progress.csv"):
        losses = [float(row["loss"]) for row in rows_of(tmp_path / curve)]
        assert losses[-1] < 0.7 * losses[0]


@pytest.mark.slow
def test_both_halves_leave_curves_and_checkpoints(run):
    for file, half in (("privileged.csv", "lbc-privileged"), ("progress.csv", "lbc")):
        rows = rows_of(run / file)
        assert rows[-1]["success_heldout"] != ""
        losses = [float(row["loss"]) for row in rows]
        assert losses[-1] < 0.95 * losses[0]
        _, told = load_agent(run / {"lbc": BEST, "lbc-privileged": PRIVILEGED_FILE}[half])
        assert (told["algorithm"], told["seed"]) == (half, 1)
        assert told["evaluation"]["journeys"] == 1
    assert told["steps"] == SAMPLES


@pytest.mark.soak  # a training of its own
@pytest.mark.slow
def test_the_privileged_agent_is_evaluated_after_its_own_minutes(tmp_path):
    options = (*SMALL, "privileged_share=1e-7")  # less than a millisecond of the hour
    train(directory=tmp_path, samples=32, minutes=60, device="cpu", threads=1, options=options)
    assert load_agent(tmp_path / PRIVILEGED_FILE)[1]["evaluation"]["journeys"] == 1


@pytest.mark.slow
def test_a_run_resumes_where_it_stopped_and_refuses_what_does_not_fit(run, tmp_path):
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    more = SAMPLES + 64
    train(directory=folder, samples=more, device="cpu", threads=1, resume=True)
    steps = [int(row["step"]) for row in rows_of(folder / "progress.csv")]
    assert steps == sorted(steps)
    assert steps[-1] == more
    assert load_agent(folder / BEST)[1]["steps"] == more
    rows, kept = rows_of(folder / "progress.csv"), load_agent(folder / BEST)[1]["evaluation"]
    train(directory=folder, minutes=1e-3, device="cpu", threads=1, resume=True)  # they are used up
    assert rows_of(folder / "progress.csv") == rows
    assert load_agent(folder / BEST)[1]["evaluation"] == kept
    for arguments, said in (
        ({"resume": True, "seed": 2}, "has seed 1"),
        ({"resume": True, "options": ["width=16"]}, "own options"),
        ({}, "resume it"),
    ):
        with pytest.raises(TrainingError, match=said):
            train(directory=folder, samples=1, device="cpu", **arguments)


@pytest.mark.slow
def test_a_run_that_is_interrupted_in_its_last_evaluation_goes_on(run, tmp_path):
    def interrupt(half, row):
        if "success_heldout" in row:
            raise KeyboardInterrupt

    begin = {"directory": tmp_path, "device": "cpu", "threads": 1}
    with pytest.raises(KeyboardInterrupt):
        train(**begin, samples=32, teacher=run / PRIVILEGED_FILE, options=SMALL, on_row=interrupt)
    assert load_agent(tmp_path / BEST)[1]["evaluation"] == {}
    train(**begin, resume=True)
    assert load_agent(tmp_path / BEST)[1]["evaluation"]["journeys"] == 1


@pytest.mark.slow
def test_a_given_teacher_teaches_an_agent_of_another_width(run, tmp_path):
    given, folder = run / PRIVILEGED_FILE, tmp_path / "run"
    options = (*SMALL, "width=4")
    train(directory=folder, samples=32, device="cpu", threads=1, teacher=given, options=options)
    train(directory=folder, samples=64, device="cpu", threads=1, resume=True)
    assert load_agent(folder / BEST)[1]["steps"] == 64
    assert (folder / PRIVILEGED_FILE).read_bytes() == given.read_bytes()
    assert not (folder / "privileged.csv").exists()
    told = json.loads((folder / "config.json").read_text())
    assert told["teacher"] == hashlib.sha256(given.read_bytes()).hexdigest()
    for arguments, said in (
        ({"teacher": run / BEST}, "is of lbc; name the privileged.pt"),
        ({"teacher": tmp_path / "none.pt"}, "teacher .*: there is no such file; name the privileged.pt"),
        ({"teacher": run}, "teacher .*: is no file; name the privileged.pt"),
        ({"teacher": given, "resume": True}, "leave --teacher out"),
    ):
        with pytest.raises(TrainingError, match=said):
            train(directory=tmp_path / "other", samples=1, device="cpu", **arguments)
    assert not (tmp_path / "other").exists()


@pytest.mark.slow
@pytest.mark.parametrize("file", [BEST, pytest.param(PRIVILEGED_FILE, marks=pytest.mark.soak)])
def test_the_file_drives_as_the_checkpoint_does(run, file, tmp_path):
    exported = tmp_path / "agent.onnx"
    agent, told = load_agent(run / file)
    compared = record_observations(SHIPPED_AGENTS[told["algorithm"]].track, 12, seed=4)
    found = export_lbc(run / file, exported, "fp16", compared=compared)
    assert found is not None
    assert found.observations == 12
    assert max(found.mean) <= max(found.greatest) < 5e-3
    source = resolve(str(exported))
    driver = source.make()
    assert (source.track, driver.memoryless) == ("privileged" if file == PRIVILEGED_FILE else "camera", False)
    seen = compared
    driver.reset(None)
    memory = torch.zeros(1, MEMORY)
    for i in range(6):
        action = driver.act({key: array[i] for key, array in seen.items()})
        with torch.inference_mode():
            wanted, memory = agent.drive_on({key: torch.from_numpy(seen[key][i : i + 1]) for key in agent.keys}, memory)
        assert [action.steer, action.throttle, action.brake] == pytest.approx(wanted[0].tolist(), abs=5e-3)


def test_the_newest_samples_are_kept():
    samples = Samples(5)
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


def test_a_teacher_tells_all_commands_or_the_experts_for_one():
    cars = Cars(8, LBCConfig(traffic=0.0), seed=1, pictures=False, device=torch.device("cpu"))
    seen = cars.observe()
    waypoints, points, weights = Teacher(Told(), white_box=True).teach(cars, seen)
    assert weights.tolist() == [[1.0] * 4] * 8
    assert torch.allclose(points, to_picture(Told()(seen)))
    assert torch.allclose(waypoints[:, 0, 0], 2.0 * seen["command"][:, 0])
    waypoints, points, weights = Teacher(Told(), white_box=False).teach(cars, seen)
    assert weights.argmax(1).tolist() == (seen["command"][:, 0] - 1).tolist()
    assert weights.sum(1).tolist() == [1.0] * 8
    assert torch.allclose(points, to_picture(waypoints)[:, None].expand(-1, 4, -1, -1))
    cars.close()


@pytest.mark.parametrize(
    ("option", "said"),
    [
        ("width=0", "option width: is 0"),
        ("guided=1.5", "option guided: is 1.5"),
        ("near_junctions=0.9", "more than all drives"),
        ("window_nearest=30", "the least and the greatest distance"),
        ("begin=1000000", "more than the buffer"),
        ("privileged_share=1", "between 0 and 1"),
        ("white_box=maybe", "give true or false"),
        ("speed=3", "give name=value with one of"),
        ("batch_size=1", "2 or more"),
        ("vehicles=201", "option vehicles: is 201; give at most 200"),
        ("pedestrians=500", "option pedestrians: is 500; give at most 200"),
        ("buffer=1000000000", "GiB of pictures"),
    ],
)
def test_wrong_options_are_named(option, said, tmp_path):
    with pytest.raises(TrainingError, match=said):
        train(directory=tmp_path / "run", samples=1, device="cpu", options=[option])
    assert not (tmp_path / "run").exists()


def test_threads_that_cannot_be_make_no_directory(tmp_path):
    with pytest.raises(TrainingError, match="threads: is 999999; give a whole number from 1 to 1024"):
        train(directory=tmp_path / "run", samples=1, device="cpu", threads=999_999)
    assert not (tmp_path / "run").exists()


def test_a_run_of_another_algorithm_is_named(tmp_path):
    config = {"seed": 1, "steps": 1, "minutes": None}
    (tmp_path / "config.json").write_text(
        json.dumps({"algorithm": "marln", **config, "config": config_of("marln").as_dict()})
    )
    with pytest.raises(TrainingError, match="holds a run of marln; resume it with 'wrongturn train marln'"):
        train(directory=tmp_path, resume=True)
    (tmp_path / "config.json").write_text(json.dumps({"algorithm": "lbc", **config, "config": {"vehicles": 500}}))
    with pytest.raises(TrainingError, match="option vehicles: is 500; give at most 200"):
        train(directory=tmp_path, resume=True)
    for algorithm in ("marln", "ppo-image"):
        with pytest.raises(TrainingError, match="holds a run of lbc; resume it with 'wrongturn train lbc'"):
            train_by_reward(algorithm, directory=tmp_path, resume=True)


def test_ablations_have_names():
    assert LBCConfig().variant is None
    assert LBCConfig(rounds=0).variant == "without-dagger"
    assert LBCConfig(rounds=0, white_box=False).variant == "without-white-box-and-dagger"


def test_other_files_are_refused(tmp_path):
    torch.save({"algorithm": "lbc"}, tmp_path / "part.pt")
    (tmp_path / "text.pt").write_text("no checkpoint")
    for name in ("part.pt", "text.pt", "missing.pt"):
        with pytest.raises(TrainingError, match=name):
            load_agent(tmp_path / name)
    assert not is_lbc(tmp_path / "text.pt")
