"""The camera's parameters, and where points are seen."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wrongturn_sim import SimError
from wrongturn_sim.camera import Camera, CameraError


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("width", 0),
        ("height", 0),
        ("width", 4096),
        ("height", 64.0),
        ("width", True),
        ("focal", 0.0),
        ("focal", math.nan),
        ("cx", math.inf),
        ("cy", "26"),
        ("up", 0.0),
        ("pitch", 2.0),
        ("yaw", math.nan),
        ("forward", -100.0),
    ],
)
def test_a_bad_parameter_is_named(name, value):
    with pytest.raises(CameraError, match=f"{name} is .*; give") as caught:
        Camera(**{name: value})
    assert isinstance(caught.value, SimError)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("fov", [0.0, 180.0, math.nan, "90", True])
def test_a_bad_field_of_view_is_named(fov):
    with pytest.raises(CameraError, match="fov_degrees"):
        Camera.of_fov(fov)


def test_a_field_of_view_becomes_a_focal_length():
    camera = Camera.of_fov(90.0, 200, 100)
    assert camera.focal == pytest.approx(100.0)
    assert (camera.cx, camera.cy) == (100.0, 50.0)
    with pytest.raises(CameraError, match="width"):
        Camera.of_fov(90.0, 0)


def test_the_defaults_project_as_the_design_says():
    camera = Camera()
    ahead = camera.project(np.array([[20.7, 0.0, 1.6], [20.7, 0.0, 0.0], [20.7, 5.0, 1.6]]), 0.0, 0.0, 0.0)
    assert ahead[0] == pytest.approx([96.0, 26.0])
    assert ahead[1] == pytest.approx([96.0, 26.0 + 107.4 * 1.6 / 20.0])
    assert ahead[2] == pytest.approx([96.0 - 107.4 * 5.0 / 20.0, 26.0])
    assert np.isnan(camera.project(np.array([[-5.0, 0.0, 1.0]]), 0.0, 0.0, 0.0)).all()


@given(
    x=st.floats(-200, 200),
    y=st.floats(-200, 200),
    yaw=st.floats(-4, 4),
    pitch=st.floats(-0.5, 0.5),
    turn=st.floats(-1, 1),
)
def test_projection_follows_the_pinhole_formula(x, y, yaw, pitch, turn):
    camera = Camera(pitch=pitch, yaw=turn, left=0.2)
    cos, sin = math.cos(yaw), math.sin(yaw)
    eye = np.array([x + 0.7 * cos - 0.2 * sin, y + 0.7 * sin + 0.2 * cos, 1.6])
    look = yaw + turn
    ahead = np.array([math.cos(look), math.sin(look), 0.0])
    left = np.array([-math.sin(look), math.cos(look), 0.0])
    for u, v, depth in ((10.0, 50.0, 3.0), (180.0, 5.0, 40.0), (96.0, 26.0, 15.0)):
        # Out along the pixel's ray, tilted about the camera's left.
        right_share, down_share = (u - 96.0) / 107.4, (v - 26.0) / 107.4
        on = math.cos(pitch) - down_share * math.sin(pitch)
        down = math.sin(pitch) + down_share * math.cos(pitch)
        point = eye + depth * (on * ahead - right_share * left - down * np.array([0.0, 0.0, 1.0]))
        assert camera.project(point[None], x, y, yaw)[0] == pytest.approx([u, v], abs=1e-6)
