import dataclasses

import numpy as np
import pytest

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.view import Surface, ViewError

TRIANGLE = np.array([[0, 1, 2]])


@pytest.mark.parametrize(("triangles", "points"), [
    (np.zeros((4, 3)), None),
    (np.zeros((4, 2), int), None),
    (np.array([[0, 1, -1]]), None),
    (TRIANGLE, np.zeros((2, 3))),
    (TRIANGLE, np.zeros((3, 2))),
])
def test_an_invalid_surface_is_refused_by_its_name(triangles, points):
    with pytest.raises(ViewError, match="of cube"):
        Surface("cube", triangles, points)


@pytest.mark.parametrize(("key", "value"), [
    ("bodies", (Surface("body", TRIANGLE),) * 2),
    ("points", None),
    ("obstacles", (Surface("floor", TRIANGLE, np.eye(3)),) * 2),
    ("force_scale", 0.0),
    ("force_scale", np.nan),
    ("tension_range", (20.0, 0.0)),
    ("tension_range", (0.0, np.inf)),
    ("cable_names", ("left", "left")),
    ("pressure_range", (0.0, 0.0)),
    ("pressure_range", (1.0, 2.0)),
    ("pressure_range", (-np.inf, 2.0)),
    ("cavities", (Surface("air", TRIANGLE),) * 2),
    ("effector_names", ("tip", "tip")),
])
def test_a_stage_that_cannot_be_shown_is_refused_by_name(stage, key, value):
    changes = {key: value} if key != "points" else {"rigid_bodies": (Surface("cube", TRIANGLE),)}
    with pytest.raises(SoftRobotTwinError) as refusal:
        dataclasses.replace(stage, **changes)
    assert refusal.value.key == key
    assert key in str(refusal.value)


def test_a_frame_that_fits_the_stage_is_accepted(stage, make_frame):
    make_frame(0).check_against(stage)


@pytest.mark.parametrize(("key", "value"), [
    ("surface_positions", ()),
    ("positions of body", np.zeros((3, 3))),
    ("positions of body", np.zeros((4, 2))),
    ("rigid_positions", np.zeros((1, 3))),
    ("rigid_quaternions", np.zeros((1, 4))),
    ("contact_positions", np.zeros((1, 3))),
    ("contact_forces", np.zeros((1, 3))),
    ("cable_paths", ()),
    ("cable_lengths", np.zeros(3)),
    ("cable_tensions", np.zeros(1)),
    ("effector_positions", np.zeros((2, 3))),
    ("targets", np.zeros(3)),
    ("predicted_markers", np.zeros((2, 3))),
    ("measured_markers", np.zeros((4, 3))),
])
def test_an_array_of_another_shape_than_the_stage_is_refused_by_name(stage, make_frame, key, value):
    changes = {key: value}
    if key == "positions of body":
        changes = {"surface_positions": (value,)}
    with pytest.raises(ViewError) as refusal:
        make_frame(0, **changes).check_against(stage)
    assert refusal.value.key == key
