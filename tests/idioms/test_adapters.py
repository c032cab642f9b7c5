"""Published models drive as ``docs/examples/adapters`` connects them, here with stand-in networks."""

import re

import numpy as np
import pytest
import stand_ins

from wrongturn_agents.errors import AgentFailedError, NotAnAgentError
from wrongturn_agents.evaluation_run import made_once
from wrongturn_agents.worker import begin, drive
from wrongturn_client import Client
from wrongturn_networks import load_suite
from wrongturn_protocol import Command, Rig, RigCamera
from wrongturn_protocol.observations import observation_space, sentence_of
from wrongturn_sim import Episode

ADAPTERS = list(stand_ins.NETWORKS)
LONG = ("Navsim", "Openpilot", "SimLingo")
"""Those of which the pictures take longest."""


def seen(agent, **values):
    """Return an observation with black pictures, and zeros in all but the values."""
    space = observation_space(agent.rig)
    made = {name: np.zeros(box.shape, box.dtype) for name, box in space.items()}
    for name, value in values.items():
        made[name][:] = value
    return made


def given(agent, **values):
    """Return what the stand-in was given for an observation, and the answer."""
    answer = agent.act(seen(agent, **values))
    return agent.network.given, np.asarray(answer, float)


@pytest.mark.parametrize("name", ADAPTERS)
def test_an_adapter_is_a_recipe_of_at_most_120_lines(name):
    file = stand_ins.FOLDER / f"{stand_ins.NETWORKS[name][0]}.py"
    assert len(file.read_text().splitlines()) <= 120
    told = stand_ins.adapter(file.stem).__doc__
    assert re.search(r"^Code( and weights)?: https://github\.com/[\w-]+/[\w-]+ \(.+\)", told, re.MULTILINE)
    assert re.search(r"^What changes: (.|\n)+\.\s+Nothing\s+else\.", told, re.MULTILINE)


@pytest.mark.parametrize("name", [pytest.param(one, marks=[pytest.mark.soak] * (one in LONG)) for one in ADAPTERS])
def test_an_adapter_drives_a_suite_to_a_row(service, name, tmp_path, monkeypatch):
    monkeypatch.setenv("WRONGTURN_HOME", str(tmp_path))
    source, parallel = made_once(f"stand_ins:{name}", None)
    run = begin(f"stand_ins:{name}", "smoke@3", source, service.url, name=f"stand-in of {name}")
    drive(run, source, service.url, lambda _finished, _total: None, parallel=parallel)
    with Client(service.url, run.token) as client:
        results = client.run_file(run.evaluation)
    assert len(results.episodes) == 12
    assert results.metrics.unsafe.count == 6  # the stand-ins leave the road
    assert results.driver.track == getattr(stand_ins, name).track


def test_tcp_is_given_what_its_network_learned():
    agent = stand_ins.Tcp()
    red = {"rgb": (255, 0, 0), "speed": 6.0, "command": Command.RIGHT, "target_points": [(20, 3), (40, 9)]}
    (image, state, _), controls = given(agent, **red)
    assert image[0, :, 0, 0] == pytest.approx([(1 - 0.485) / 0.229, -0.456 / 0.224, -0.406 / 0.225])
    assert state[0] == pytest.approx([0.5, -3, -20, 0, 1, 0, 0, 0, 0])
    # By hand: the trajectory's points are 6 m/s fast and bend right, but the target is at an angle of -0.095. The first
    # error goes into a window of 40, so the turn is -0.095 * (0.75 + 0.75 / 40 + 0.3); the branch steers by 0.5.
    turn = -np.arctan2(3, 20) * 2 / np.pi * (0.75 + 0.75 / 40 + 0.3)
    pace = 2 * np.mean(np.linalg.norm(np.diff(stand_ins.bend((0.5, 1.0, 1.5, 2.0)), axis=0), axis=1)) - 6.0
    assert pace < 0  # chords are shorter than the arc, so the controller asks for no throttle
    assert controls == pytest.approx([1.3 * (0.7 * turn + 0.3 * 0.5), 0.3 * 0.5, 0.0])


def test_tcp_leads_with_its_branch_of_control_once_it_has_turned_for_half_a_second():
    agent = stand_ins.Tcp()
    answers = [given(agent, target_points=[(8, 0), (20, 0)], command=Command.LEFT)[1] for _ in range(14)]
    assert answers[0][0] == pytest.approx(1.3 * 0.3 * 0.5)
    assert answers[-1][0] == pytest.approx(1.3 * 0.7 * 0.5)


def test_the_ends_of_a_beta_distribution_are_modes_too():
    mode = stand_ins.adapter("tcp").mode
    found = mode(np.array([3.0, 0.5, 2.0, 0.5]), np.array([2.0, 2.0, 0.5, 0.5]))
    assert found == pytest.approx([2 / 3, 0.0, 1.0, 0.5])


def test_transfuser_sees_left_front_and_right_side_by_side():
    agent = stand_ins.TransFuser()
    pictures = {"left": 10, "front": 20, "right": 30}
    (image, target, velocity), waypoints = given(agent, **pictures, speed=5.0, target_points=[(15, -2), (30, 0)])
    columns = image[0, 0, 0]
    assert [int(one) for one in (columns[191], columns[192], columns[511], columns[512])] == [10, 20, 20, 30]
    assert target.tolist() == [[2.0, -15.0]]
    assert velocity.tolist() == [[5.0]]
    assert waypoints == pytest.approx(stand_ins.bend((0.5, 1.0, 1.5, 2.0)))  # from the LiDAR's frame to the car's


@pytest.mark.parametrize(
    ("command", "place"),
    [(Command.LEFT, 0), (Command.STRAIGHT, 1), (Command.LANE_FOLLOW, 1), (Command.RIGHT, 2), (Command.VOID, 3)],
)
def test_navsim_has_an_order_of_its_own(command, place):
    (_, status), _ = given(stand_ins.Navsim(), command=command)
    assert status[0].tolist() == [float(n == place) for n in range(4)] + [0.0] * 4


def test_navsim_is_given_the_car_in_the_frame_of_its_rear_axle():
    agent = stand_ins.Navsim()
    given(agent, speed=5.0, command=Command.LEFT)
    (image, status), waypoints = given(agent, speed=5.2, steering=-0.5, command=Command.LEFT, l0=51, f0=102, r0=204)
    assert image[0, 1, 0, [271, 272, 751, 752]] == pytest.approx([0.2, 0.4, 0.4, 0.8])
    to_the_left = 5.2**2 * np.tan(0.5 * np.radians(35)) / 2.9
    assert status[0, 4:] == pytest.approx([5.2, 0.0, 2.0, to_the_left], abs=1e-4)
    assert waypoints.shape == (8, 2)
    assert agent.rig.action.behind == 1.45


def test_simlingo_is_told_the_sentence_and_drives_along_its_route_at_the_pace_of_its_waypoints():
    agent = stand_ins.SimLingo()
    sentence = sentence_of("Turn left in 11 m.")
    picture = np.zeros((512, 1024, 3), np.uint8)
    picture[:, 512:] = 255
    (tiles, prompt, speed), _ = given(agent, speed=5.26, sentence=sentence, rgb=picture)
    assert prompt == "Current speed: 5.3 m/s. Command: Turn left in 11 m. Predict the waypoints."
    assert speed.item() == pytest.approx(5.3)
    assert [round((tiles[0, 0, side] < 0).mean(), 1) for side in (0, 1)] == [1.0, 0.0]
    straight = np.stack([np.arange(1.0, 21.0), np.zeros(20)], axis=1)
    sideways = np.stack([np.zeros(10), 3.0 * np.arange(1.0, 11.0)], axis=1)
    agent.network = lambda *_inputs: (sideways[None], straight[None], "")
    assert agent.act(seen(agent)) == pytest.approx(sideways[:, ::-1])  # past the route's end in its direction


def test_openpilot_is_told_a_desire_as_a_pulse():
    agent = stand_ins.Openpilot()
    told = []
    for command in (Command.LANE_FOLLOW, Command.LEFT, Command.LEFT, Command.STRAIGHT, Command.RIGHT):
        inputs, waypoints = given(agent, command=command)
        told.append(np.flatnonzero(inputs["desire"][0, -1]).tolist())
    assert told == [[], [1], [], [], [2]]
    assert inputs["desire"][0, -4, 1] == 1.0
    assert inputs["features_buffer"][0, :, 0].tolist() == [0.0] * 95 + [1.0] * 4
    assert inputs["prev_desired_curv"][0, -5:, 0].tolist() == [0.0] + [0.5] * 4
    assert waypoints == pytest.approx(stand_ins.bend(agent.rig.action.times))
    agent.reset(None)
    assert not given(agent, command=Command.LANE_FOLLOW)[0]["desire"].any()


def test_openpilot_sees_planes_of_two_frames():
    frames = np.zeros((2, 256, 512, 3), np.uint8)
    frames[0] = 255
    frames[1, 1::2, ::2] = 255  # odd rows, even columns: the second plane of a frame
    inputs, _ = given(stand_ins.Openpilot(), road=frames, command=Command.LEFT)
    older, newer = inputs["input_imgs"][0, :, 60, 120].reshape(2, 6).tolist()
    assert older == [235.0] * 4 + [128.0] * 2
    assert newer == [16.0, 235.0, 16.0, 16.0] + [128.0] * 2


def test_the_papers_agent_is_given_its_plane_of_numbers():
    agent = stand_ins.Carton()
    observation = {"rgb": 51, "speed": 10.0, "steering": 0.65, "command": Command.STRAIGHT}
    seen_by_it, (steer, throttle, brake) = given(agent, **observation)
    assert seen_by_it[0, 30, 30] == pytest.approx([0.2, 0.2, 0.2, 0, 0, 0, 0, 0, 0])
    assert seen_by_it[0, 0, :4, 3] == pytest.approx([0.36, 0.5, 3.0, 0.0])
    assert (steer, throttle, brake) == pytest.approx((1.3 * 0.05, 0.8, 0.0))


def picture(**camera):
    """Return what a camera sees at the start of a trial."""
    episode = Episode(load_suite("smoke@3").open_draw.trials[0], Rig(cameras=(RigCamera(**camera),)))
    found = episode.reset()["rgb"].astype(int)
    episode.abort()
    return found


def test_cameras_show_what_the_authors_keep_of_larger_pictures():
    left = stand_ins.TransFuser.rig.cameras[0].model_copy(update={"name": "rgb"})
    published = picture(width=960, height=480, fov=120, forward=1.3, up=2.3, yaw=60)
    assert np.array_equal(picture(**left.model_dump()), published[160:320, 320:640])
    published = picture(width=256, height=192, fov=100, forward=0.7, up=1.6)
    difference = picture(**stand_ins.Carton.rig.cameras[0].model_dump()) - published[70:134, 32:224]
    assert (difference == 0).mean() > 0.97  # the benchmark's focal length is rounded


def test_the_papers_camera_is_the_benchmarks():
    camera = stand_ins.Carton.rig.cameras[0]
    assert (camera.width, camera.height, camera.horizon, camera.forward, camera.up) == (192, 64, 26, 0.7, 1.6)
    assert 96 / np.tan(np.radians(camera.fov / 2)) == pytest.approx(107.4)


WRONG = """
import numpy as np
import stand_ins
from wrongturn_protocol import Rig, RigAction, RigCamera

class Short(stand_ins.Navsim):
    def act(self, observation):
        return super().act(observation)[:6]

class Turned(stand_ins.Navsim):
    def act(self, observation):
        return super().act(observation).T

class Degrees(stand_ins.Tcp):
    def act(self, observation):
        return 20.0, 0.5, 0.0

class Milliseconds(stand_ins.TransFuser):
    rig = {"action": {"kind": "waypoints", "times": [500, 1000, 1500, 2000]}, "navigation": ["target_points"]}

class Backwards(stand_ins.TransFuser):
    rig = {"action": {"kind": "waypoints", "times": [2.0, 1.5, 1.0, 0.5]}, "navigation": ["target_points"]}

class Told(stand_ins.SimLingo):
    rig = {"navigation": ["sentence", "command"]}

class Large(stand_ins.TransFuser):
    rig = {"cameras": [{"name": n, "width": 960, "height": 480, "fov": 120} for n in ("left", "front", "right")]}
"""


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Short", r"waypoints: have the shape \(6, 2\); give \(8, 2\)"),
        ("Turned", r"waypoints: have the shape \(2, 8\); give \(8, 2\)"),
        ("Degrees", r"action\.steer is 20\.0"),
        ("Milliseconds", r"rig\.action\.times\.0: .*60"),
        ("Backwards", r"rig\.action: times: give growing seconds"),
        ("Told", r"rig\.navigation: the track words has the sentence alone"),
        ("Large", r"rig: cameras: show 1382400 pixels at a decision"),
    ],
)
def test_a_wrong_shape_order_or_unit_is_named_before_the_first_step(name, message, tmp_path, monkeypatch):
    (tmp_path / "wrong_adapters.py").write_text(WRONG)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises((AgentFailedError, NotAnAgentError), match=rf"agent: (wrong_adapters:)?{name}.*{message}"):
        made_once(f"wrong_adapters:{name}", None)
