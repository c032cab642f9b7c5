"""The options of trials mean the same wherever an environment takes them."""

from dataclasses import fields

import numpy as np
import pytest

from wrongturn_protocol import (
    Command,
    FaultKind,
    OptionError,
    Task,
    Track,
    Traffic,
    TrialKeywords,
    TrialOptions,
    Weather,
)


def test_each_keyword_is_an_option():
    named = {field.name for field in fields(TrialOptions)} - {"town", "track", "weathers"}
    assert set(TrialKeywords.__annotations__) == named | {"weather"}


def test_plain_values_are_read():
    options = TrialOptions.of(
        "Town02", "privileged", fault="omission", route=1, weather=["WetNoon", "ClearSunset"], traffic={"vehicles": 3}
    )
    assert (options.town, options.track, options.fault.kind) == ("Town02", Track.PRIVILEGED, FaultKind.OMISSION)
    assert options.route is Command.LEFT
    assert options.weathers == (Weather.WET_NOON, Weather.CLEAR_SUNSET)
    assert options.traffic == Traffic(vehicles=3)
    assert TrialOptions.of() == TrialOptions()
    assert TrialOptions.of(task="one_turn").task is Task.ONE_TURN


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"track": "sonar"}, "track: 'sonar' is unknown; give one of camera"),
        ({"fault": "gremlins"}, "fault: 'gremlins' is unknown; give one of none"),
        ({"task": "wander"}, "task: .*navigation_dynamic"),
        ({"weather": "Fog"}, "weather: 'Fog' is unknown; give one of ClearNoon"),
        ({"weather": []}, "weather: none"),
        ({"route": 4}, r"route: 4 is no direction; give one of 1 \(LEFT\)"),
        ({"track": "cam"}, r"track: 'cam' is unknown; .*\. Did you mean camera\?"),
        ({"fault": "infeasable"}, r"fault: 'infeasable' .*\. Did you mean infeasible\?"),
        ({"weather": "clearnoon"}, r"weather: .*\. Did you mean ClearNoon\?"),
        ({"track": ["camera"]}, r"track: \['camera'\] is unknown"),
        ({"town": 5}, "town: is 5; give its name as text"),
        ({"town": "Town01", "approach": ["J1-S"]}, r"approach: is \['J1-S'\]; give its name as text"),
        ({"suite": 2}, "suite: is 2; give its name as text"),
        ({"suite": "smoke@3", "trial": 7}, "trial: is 7; give the id of one of the suite's trials"),
        ({"route": "LEFT"}, r"route: 'LEFT' is no direction; give one of 1 \(LEFT\)"),
        ({"route": True}, "route: True is no direction"),
        ({"route": np.array([1, 2])}, "route: array"),
        ({"traffic": 20}, r"traffic: is 20; give numbers by name, such as \{'vehicles': 20, 'pedestrians': 10}"),
        ({"traffic": {"cars": 20}}, r"traffic\.cars: there is no such option; give vehicles, pedestrians$"),
        ({"traffic": {"vehicle": 20}}, r"traffic\.vehicle: there is no such option; .* Did you mean vehicles\?"),
        ({"traffic": {"vehicles": -1}}, r"traffic\.vehicles: is -1; give a whole number from 0 to 200"),
        ({"traffic": {"vehicles": "many"}}, r"traffic\.vehicles: is 'many'; give a whole number from 0 to 200"),
        ({"suite": "smoke@3", "town": "Town01"}, "leave town and approach out"),
        ({"suite": "smoke@3", "task": "straight"}, "leave task out"),
        ({"trial": "Town01.J1-S.none.s1"}, "give suite too"),
        ({"journeys": {"lateral": 0.1}}, "give task='cruise'"),
        ({"task": "cruise", "journeys": 3}, "journeys: 3"),
        ({"task": "cruise", "approach": "J1-S"}, "approach: "),
        ({"task": "navigation", "fault": "omission"}, "fault: .* omission"),
        ({"task": "navigation", "route": 1}, "route: "),
    ],
)
def test_what_does_not_go_together_says_why(given, named):
    with pytest.raises(OptionError, match=named):
        TrialOptions.of(**given)


def test_an_option_that_does_not_exist_is_named():
    with pytest.raises(TypeError, match=r"wether: there is no such option; .*\. Did you mean weather\?"):
        TrialOptions.of(wether="WetNoon")
    with pytest.raises(TypeError, match=r"twon: .*\. Did you mean town\?"):
        TrialOptions.of(twon="Town01")


def test_a_single_weather_takes_no_draw():
    one, several = TrialOptions.of(), TrialOptions.of(weather=list(Weather))
    random = np.random.default_rng(0)
    before = random.bit_generator.state
    assert one.draw_weather(random) is Weather.CLEAR_NOON
    assert random.bit_generator.state == before
    assert len({several.draw_weather(random) for _ in range(100)}) == len(Weather)
