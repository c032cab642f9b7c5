import dataclasses
import itertools

import torch

from wrongturn_agents.training.drive import drive_trials
from wrongturn_agents.training.held_out import Evaluation, held_out_journeys, shortest, with_traffic
from wrongturn_networks import draw_journey, load_suite, load_town
from wrongturn_protocol import Task, Traffic, Verdict
from wrongturn_sim.camera import Camera


class Constant:
    """Drives by the same controls wherever it is."""

    def __init__(self, steer, throttle, brake):
        self.controls = torch.tensor([steer, throttle, brake])
        self.batches = []
        self.last = {}

    def drive(self, observation):
        self.batches.append(len(observation["speed"]))
        self.last = observation
        return self.controls.expand(len(observation["speed"]), 3)


class Counting:
    """Remembers how many decisions its drive has had, and drives the faster the more there were."""

    def __init__(self):
        self.counts = []

    def begin(self, count):
        return torch.zeros(count, 1)

    def drive_on(self, observation, memory):
        self.counts.append(memory.max().item())
        memory = memory + 1
        return torch.cat(
            [torch.zeros_like(memory), (0.005 * memory).clamp(max=1.0), torch.zeros_like(memory)], 1
        ), memory


def short_journeys():
    return [draw_journey(load_town(town), Task.STRAIGHT, seed) for town in ("Town02", "Town01") for seed in (1, 2, 3)]


def test_trials_of_several_towns_come_back_in_their_order():
    trials = short_journeys()
    (driven,) = drive_trials([Constant(0.5, 0.8, 0.0)], trials, track="state", batch=2)
    assert [one.trial.id for one in driven] == [trial.id for trial in trials]
    assert {one.outcome.verdict for one in driven} <= {Verdict.COLLISION, Verdict.TIMEOUT}
    assert all(one.outcome.journey is not None for one in driven)


def test_how_many_are_driven_side_by_side_changes_nothing():
    trials = list(load_suite("smoke@3").episodes)
    one, many = (drive_trials([Constant(0.05, 0.5, 0.0)], trials, track="state", batch=batch) for batch in (1, 5))
    assert one == many


def test_a_model_that_remembers_begins_anew_in_each_drive():
    trials = list(load_suite("smoke@3").episodes)
    (alone,) = drive_trials([Counting()], trials, track="state", batch=1)
    remembering, other = Counting(), Constant(0.05, 0.5, 0.0)
    beside, _ = drive_trials([remembering, other], trials, track="state", batch=3)
    assert beside == alone
    assert max(remembering.counts) < 600


def test_standing_cars_are_given_up():
    driver = Constant(0.0, 0.0, 1.0)
    (driven,) = drive_trials([driver], short_journeys()[:3], track="state", batch=2, patience=3.0)
    assert [one.outcome for one in driven] == [None] * 3
    assert len(driver.batches) <= 70


def test_cars_see_through_the_camera_that_is_given():
    driver, seen = Constant(0.0, 0.0, 1.0), []
    for camera in (None, Camera(), Camera(up=2.0)):
        drive_trials([driver], short_journeys()[3:4], track="segmentation", patience=0.2, camera=camera)
        seen.append(driver.last["segmentation"].clone())
    assert [torch.equal(seen[0], one) for one in seen[1:]] == [True, False]


def test_held_out_journeys_are_in_no_suite():
    journeys = held_out_journeys(8)
    known = {trial.seed for trial in load_suite("navigation@1").trials}
    assert not known & {trial.seed for trial in journeys}
    assert {trial.journey.task for trial in journeys} == {Task.NAVIGATION}
    assert len({trial.weather for trial in journeys}) == 4
    assert {trial.town for trial in journeys} == {"Town01"}
    chosen = shortest(journeys, 3)
    assert [trial for trial in journeys if trial in chosen] == chosen
    longest = max(trial.journey.time_limit for trial in chosen)
    assert sum(trial.journey.time_limit > longest for trial in journeys) == 5


def test_journeys_beside_others_are_counted_apart():
    alone = [draw_journey(load_town("Town01"), Task.STRAIGHT, seed) for seed in range(4)]
    beside = with_traffic(alone)
    assert [(one.seed, one.start, one.journey.goal) for one in beside] == [
        (one.seed, one.start, one.journey.goal) for one in alone
    ]
    assert {one.traffic for one in beside} == {Traffic(vehicles=20, pedestrians=50)}
    assert {one.journey.task for one in beside} == {Task.NAVIGATION_DYNAMIC}
    models, options = [Constant(0.0, 0.6, 0.0)], {"track": "state", "patience": 5.0}
    (first,), (both,) = (Evaluation.each(models, trials, **options) for trials in (alone, [*alone, *beside]))
    (driven,) = drive_trials(models, [*alone, *beside], **options)
    arrived = [one.outcome is not None and one.outcome.verdict is Verdict.ARRIVED for one in driven]
    assert dataclasses.replace(both, traffic_success=None) == first
    assert (both.success, both.traffic_success) == (sum(arrived[:4]) / 4, sum(arrived[4:]) / 4)
    assert 0 <= both.clean <= both.success
    assert Evaluation(4, 0.9, 0.9, 1.0, 0.2).rank < Evaluation(4, 0.8, 0.8, 0.0, 0.4).rank
    assert Evaluation(4, 0.5, 0.5, 1.0).rank < Evaluation(4, 0.75, 0.0, -9.0).rank


def test_several_agents_drive_side_by_side_as_each_alone():
    trials = [draw_journey(load_town("Town01"), Task.STRAIGHT, seed) for seed in range(2)]
    drivers = [Constant(0.0, 0.6, 0.0), Constant(0.0, 0.0, 1.0), Constant(0.3, 0.8, 0.0)]
    options = {"track": "state", "patience": 3.0, "strict": True}
    together = Evaluation.each(drivers, trials, **options)
    assert together == [Evaluation.each([driver], trials, **options)[0] for driver in drivers]
    assert len({found.reward for found in together}) == 3


def test_an_evaluation_that_was_stopped_counts_the_journeys_that_all_agents_ended():
    trials = [draw_journey(load_town("Town01"), Task.STRAIGHT, seed) for seed in range(4)]
    drivers = [Constant(0.0, 0.6, 0.0), Constant(0.3, 0.8, 0.0)]

    def stopped_after(decisions: int, least: int | None) -> list[Evaluation] | None:
        calls = itertools.count(1)
        return Evaluation.each(drivers, trials, track="state", stop=lambda: next(calls) > decisions, least=least)

    taken = []
    for trial in trials:
        drivers[0].batches.clear()
        Evaluation.each(drivers, [trial], track="state")
        taken.append(len(drivers[0].batches))
    decisions = sorted(taken)[1]
    ended = [trial for trial, count in zip(trials, taken, strict=True) if count <= decisions]
    assert 0 < len(ended) < len(trials)
    assert stopped_after(decisions, len(ended)) == Evaluation.each(drivers, ended, track="state")
    assert stopped_after(decisions, len(ended) + 1) is None
    assert stopped_after(decisions, None) is None
