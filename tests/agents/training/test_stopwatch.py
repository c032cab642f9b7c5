import pytest
import torch

from wrongturn_agents.training.stopwatch import Stopwatch


def test_an_inner_part_is_not_counted_twice():
    now = [0.0]
    watch = Stopwatch(torch.device("cpu"), clock=lambda: now[0])
    with watch.part("env"):
        now[0] += 1.0
        with watch.part("render"):
            now[0] += 2.0
        now[0] += 4.0
    now[0] += 8.0
    assert watch.lap() == pytest.approx({"env": 5.0, "render": 2.0, "rest": 8.0, "whole": 15.0})
    assert watch.lap()["whole"] == 0.0
