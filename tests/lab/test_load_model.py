"""The model of a service's load keeps the laws of queues."""

from dataclasses import replace

import pytest

from lab.load_model import Load, flow, processor_hours

LOAD = Load(service=0.0005, simulator=0.001, client=0.0002, think=0.002)


def test_one_agent_waits_for_nobody() -> None:
    assert flow(LOAD, 1).steps_per_s == pytest.approx(1 / (0.0005 + 0.001 + 0.0002 + 0.002), rel=0.1)


def test_one_thread_is_the_limit_of_many_and_two_carry_twice_as_much() -> None:
    one, two = flow(LOAD, 200), flow(replace(LOAD, services=2), 200)
    assert one.steps_per_s == pytest.approx(1 / LOAD.service, rel=0.05)
    assert one.busy == pytest.approx(1, abs=0.05)
    assert two.steps_per_s == pytest.approx(2 * one.steps_per_s, rel=0.05)
    # Little's law: all that do not think wait for a step.
    assert one.steps_per_s * (one.step_s + 0.0022) == pytest.approx(200, rel=0.1)


def test_shared_processors_bound_it_and_a_cost_is_what_each_step_takes() -> None:
    assert flow(replace(LOAD, think=0.0, processors=2), 8).steps_per_s <= 1.05 * 2 / (0.0005 + 0.001 + 0.0002)
    assert processor_hours(LOAD, 1)["simulators"] == pytest.approx(12_000 * 0.001 / 3600)
