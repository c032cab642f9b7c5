import sys
from pathlib import Path

import pytest

from wrongturn_agents import AGENTS, Agent, list_agents, resolve
from wrongturn_agents.errors import AgentImportError, AgentsError, ModelFileError, NotAnAgentError, UnknownAgentError
from wrongturn_agents.registry import GROUP
from wrongturn_client.errors import PluginError
from wrongturn_client.plugins import entry_points
from wrongturn_protocol import AgentKind, Track
from wrongturn_protocol.reserved_names import SHIPPED_NAMES

OWN = '''
from wrongturn_protocol import Action

class Own:
    """Drives straight on.

    More of it.
    """

    track = "state"

    def reset(self, observation_space): ...

    def act(self, observation):
        return Action(steer=0.0, throttle=0.5, brake=0.0)

class Doubting(Own):
    trained_on_faults = True

class NoTrack(Own):
    track = None

class OddTrack(Own):
    track = "sonar"

class NoAct:
    track = "state"

    def reset(self, observation_space): ...

class Needy(Own):
    def __init__(self, weights): ...

a_function = len
'''


@pytest.fixture
def own_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "own_driver.py").write_text(OWN)
    (tmp_path / "broken_driver.py").write_text("import no_such_module_here\n")
    monkeypatch.chdir(tmp_path)
    for name in ("own_driver", "broken_driver"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return "own_driver"


def test_the_five_baselines_are_listed_first():
    assert [agent.name for agent in list_agents()[:5]] == [*AGENTS]
    assert {agent.track for agent in list_agents()[:5]} == {Track.PRIVILEGED}


@pytest.mark.parametrize(
    ("name", "kind"),
    [*((name, AgentKind.BASELINE) for name in AGENTS), *((name, AgentKind.EXPLOIT) for name in entry_points(GROUP))],
)
def test_a_registered_name_makes_an_agent_that_says_what_it_is(name, kind):
    source = resolve(name)
    assert (source.name, source.kind) == (name, kind)
    agent = source.make()
    assert isinstance(agent, Agent)
    assert agent is not source.make()
    (listed,) = (one for one in list_agents() if one.name == name)
    assert listed.kind is kind
    assert listed.description.endswith(".")


def test_an_unknown_name_lists_the_known_ones():
    with pytest.raises(
        UnknownAgentError, match=r"'carefull'.*parked, .*careful, ppo-segmentation.*package.module:Class"
    ):
        resolve("carefull")


@pytest.mark.parametrize(
    ("named", "says"),
    [
        ("own_driver.py", "agent: own_driver.py is a file; write own_driver:Class"),
        ("own_driver.py:Own", "agent: own_driver.py is a file; write own_driver:Own"),
        ("./agents/own_driver.py:Own", "agent: ./agents/own_driver.py is a file; write agents.own_driver:Own"),
        ("own_driver:Onw", "agent: module own_driver has no Onw. Did you mean Own?"),
    ],
)
def test_a_name_that_is_nearly_right_is_told_the_right_one(own_module, named, says):
    with pytest.raises(AgentsError) as caught:
        resolve(named)
    assert str(caught.value) == says


def test_a_class_in_the_working_directory(own_module):
    source = resolve(f"{own_module}:Own")
    assert (source.name, source.track, source.kind) == ("Own", Track.STATE, AgentKind.SUBMITTED)
    assert source.description == "Drives straight on."
    assert isinstance(source.make(), Agent)


@pytest.mark.parametrize(
    ("named", "error", "says"),
    [
        ("no_such_module:Own", AgentImportError, "no_such_module cannot be imported: ModuleNotFoundError"),
        ("broken_driver:Own", AgentImportError, "No module named 'no_such_module_here'"),
        ("own_driver:Other", AgentImportError, "own_driver has no Other"),
        ("own_driver:", AgentImportError, "own_driver has no class name after the colon"),
        (":Own", AgentImportError, "the module before the colon is missing"),
        ("own_driver:a_function", NotAnAgentError, "is not a class"),
        ("own_driver:NoAct", NotAnAgentError, "has no method act"),
        ("own_driver:NoTrack", NotAnAgentError, "track is None; set the class attribute to one of camera"),
        ("own_driver:OddTrack", NotAnAgentError, "track is 'sonar'"),
        ("missing.onnx", ModelFileError, "missing.onnx: there is no such file"),
        ("folder.onnx", ModelFileError, "folder.onnx: is no file; name an .onnx file"),
        ("empty.onnx", ModelFileError, "is no ONNX model, or is cut off; export the model again"),
    ],
)
def test_what_is_no_agent_is_told_clearly(own_module, tmp_path, monkeypatch, named, error, says):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.onnx").mkdir()
    (tmp_path / "empty.onnx").touch()
    with pytest.raises(error) as caught:
        resolve(named)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_class_says_that_it_was_trained_on_faults(own_module):
    assert not resolve(f"{own_module}:Own").trained_on_faults
    assert resolve(f"{own_module}:Doubting").trained_on_faults


def test_a_class_that_needs_arguments(own_module):
    with pytest.raises(NotAnAgentError, match=r"cannot be made without arguments.*weights"):
        resolve(f"{own_module}:Needy").make()


def test_the_service_reserves_the_names_of_all_agents() -> None:
    assert {agent.name for agent in list_agents()} == SHIPPED_NAMES


def test_a_package_names_agents_and_a_broken_one_leaves_the_rest(tmp_path, monkeypatch, caplog):
    points = "[wrongturn.agents]\nslow = slow_car:Slow\nlost = slow_car:Nobody\n"
    for name, text in (
        ("slow_car.py", "class Slow:\n    '''Is slow.'''\n    track = 'camera'\n    reset = act = lambda *_: None\n"),
        ("slow_car-1.dist-info/METADATA", "Name: slow-car\nVersion: 1\n"),
        ("slow_car-1.dist-info/entry_points.txt", points),
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    assert [one.description for one in list_agents() if one.name in {"slow", "lost"}] == ["Is slow."]
    assert "lost is left out" in caplog.text
    assert resolve("slow").track is Track.CAMERA
    with pytest.raises(PluginError, match="'lost' of slow-car"):
        resolve("lost")
