import math

import numpy as np
import pytest

from wrongturn_sim.polyline import Polyline, fill, project


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
    assert project(corner.points, corner.along, 0, 4, *point) == pytest.approx(expected)


def test_points_are_a_metre_apart_and_end_on_the_last_point(corner):
    points = np.empty((16, 2), np.float32)
    fill(corner.points, corner.along, 0, 4, 7.5, points)
    assert points[0] == pytest.approx((7.5, 0.0))
    assert points[3] == pytest.approx((10.0, 0.5))
    assert points[12] == pytest.approx((10.0, 9.5))
    assert (points[13:] == (10.0, 10.0)).all()
