"""What the four environments say of options that they do not know, before anything is driven."""

import math
from typing import Any

import gymnasium
import pytest

from wrongturn_protocol import OptionError

SINGLE = {"wrongturn_sim:WrongturnSim-v0": {"town": "junctions"}, "wrongturn_client:Wrongturn-v0": {"url": "http://x"}}


@pytest.fixture(params=[(id_, many) for id_ in SINGLE for many in (False, True)], ids=str)
def make(request: pytest.FixtureRequest) -> Any:
    id_, many = request.param

    def made(**options: Any) -> Any:
        given = {**SINGLE[id_], **options}
        return gymnasium.make_vec(id_, num_envs=2, **given) if many else gymnasium.make(id_, **given)

    return made


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"trail": "x"}, r"^options\.trail: there is no such option; give trial.*\. Did you mean trial\?$"),
        ({"seed": 3}, r"^options\.seed: there is no such option; give trial[^.]*$"),
        (["trial"], r"^options: is \['trial'\]; give a dict with trial"),
    ],
)
def test_an_unknown_option_of_reset_is_named(make: Any, options: Any, says: str) -> None:
    env = make()
    with pytest.raises(OptionError, match=says):
        env.reset(options=options)
    env.close()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"track": "cam"}, r"^track: 'cam' is unknown; .*\. Did you mean camera\?$"),
        ({"fault": "infeasable"}, r"^fault: 'infeasable' is unknown; .*\. Did you mean infeasible\?$"),
        ({"traffic": {"vehicle": 2}}, r"^traffic\.vehicle: .*\. Did you mean vehicles\?$"),
    ],
)
def test_a_wrong_option_is_told_when_the_environment_is_made(make: Any, options: Any, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        make(**options)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"camera": "front"}, "^camera: is 'front'; give a wrongturn_sim.camera.Camera$"),
        ({"num_envs": 2, "camera": "front"}, "^camera: is 'front'; give a wrongturn_sim.camera.Camera$"),
        ({"num_envs": 2, "drive_on": "long"}, "^drive_on: is 'long'; give seconds"),
        ({"num_envs": 2, "own_traffic": True}, r"^own_traffic: is True; give a FleetTraffic"),
        ({"num_envs": 2, "copy": "no"}, "^copy: is 'no'; give True or False$"),
    ],
)
def test_an_argument_of_the_wrong_type_is_told(options: dict[str, Any], says: str) -> None:
    make = gymnasium.make_vec if "num_envs" in options else gymnasium.make
    with pytest.raises(OptionError, match=says):
        make("wrongturn_sim:WrongturnSim-v0", town="junctions", **options)


def test_an_option_that_does_not_exist_is_told_with_all_that_do(make: Any) -> None:
    with pytest.raises(
        TypeError, match=r"^rendr_mode: there is no such option; .*\. Did you mean render_mode\?"
    ) as told:
        make(rendr_mode="human")
    own = ("url", "token", "patience") if "patience" in str(told.value) else ("strict", "camera")
    for name in (*own, "render_mode", "town", "track", "traffic"):
        assert f" {name}" in str(told.value)


@pytest.mark.parametrize(
    ("journeys", "says"),
    [
        ({"time_limit": math.nan}, "time_limit: nan is no time to drive; give seconds, more than 0$"),
        ({"time_limit": -1}, "time_limit: -1 is no time to drive; give seconds, more than 0$"),
        ({"near_junctions": 2.0}, "near_junctions, near_bends, inside_junctions: .* are not shares"),
        ({"near_junction": 0.4}, r"near_junction: there is no such option; .*\. Did you mean near_junctions\?$"),
        ({"speed": 5}, "'speed': 5.* has a value of the wrong type"),
        ({"time_limit": "long"}, "'time_limit': 'long'.* has a value of the wrong type"),
        ({"least_traffic": {"vehicles": 2}}, "'least_traffic': .* has a value of the wrong type"),
    ],
)
def test_what_is_wrong_with_journeys_is_told_in_one_line(journeys: dict[str, Any], says: str) -> None:
    with pytest.raises(OptionError, match=rf"^journeys[.:].*{says}") as told:
        gymnasium.make("wrongturn_sim:WrongturnSim-v0", town="Town01", task="cruise", journeys=journeys)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("id_", SINGLE)
def test_an_unknown_autoreset_mode_is_told(id_: str) -> None:
    with pytest.raises(
        OptionError, match=r"^autoreset_mode: 'same' is unknown; give one of NextStep, SameStep, Disabled\. "
    ):
        gymnasium.make_vec(id_, num_envs=2, autoreset_mode="same", **SINGLE[id_])
