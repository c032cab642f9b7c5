import math

import numpy as np
import pytest

from wrongturn_sim.polyline import Polyline


@pytest.fixture
def corner():
    return Polyline([(0.0, 0.0), (10.0, 0.0), (10.0, 0.0), (10.0, 10.0)])


@pytest.mark.parametrize(
    ("point", "expected"),
    [
        ((4.0, 1.0), (4.0, 1.0, 0.0)),
        ((4.0, -2.0), (4.0, -2.0, 0.0)),
        ((9.0, 6.0), (16.0, 1.0, math.pi / 2)),
        ((-3.0, 0.5), (0.0, math.sqrt(9.25), 0.0)),
        ((11.0, 14.0), (20.0, -math.sqrt(17.0), math.pi / 2)),
    ],
)
def test_projection(corner, point, expected):
    assert corner.project(*point) == pytest.approx(expected)


def test_samples_are_a_metre_apart_and_end_on_the_last_point(corner):
    points = corner.sample(7.5, 16)
    assert points.dtype == np.float32
    assert points[0] == pytest.approx((7.5, 0.0))
    assert points[3] == pytest.approx((10.0, 0.5))
    assert points[12] == pytest.approx((10.0, 9.5))
    assert (points[13:] == (10.0, 10.0)).all()


def test_a_path_after_another_keeps_its_distances(corner):
    both = corner.then(Polyline([(10.0, 10.0), (0.0, 10.0)]))
    assert both.length == pytest.approx(30.0)
    assert both.project(5.0, 9.0).s == pytest.approx(25.0)
