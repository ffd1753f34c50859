import dataclasses

import numpy as np
import pytest

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.view import ViewError


@pytest.mark.parametrize(("key", "value"), [
    ("surface_triangles", np.zeros((4, 3))),
    ("surface_triangles", np.zeros((4, 2), int)),
    ("surface_triangles", np.array([[0, 1, -1]])),
    ("tension_range", (20.0, 0.0)),
    ("tension_range", (0.0, np.inf)),
    ("cable_names", ("left", "left")),
    ("effector_names", ("tip", "tip")),
])
def test_a_stage_that_cannot_be_shown_is_refused_by_name(stage, key, value):
    with pytest.raises(SoftRobotTwinError) as refusal:
        dataclasses.replace(stage, **{key: value})
    assert refusal.value.key == key
    assert key in str(refusal.value)


def test_a_frame_of_the_stage_is_not_refused(stage, make_frame):
    make_frame(0).refuse_if_unlike(stage)


@pytest.mark.parametrize(("key", "value"), [
    ("surface_positions", np.zeros((3, 3))),
    ("surface_positions", np.zeros((4, 2))),
    ("cable_paths", ()),
    ("cable_lengths", np.zeros(3)),
    ("cable_tensions", np.zeros(1)),
    ("effector_positions", np.zeros((2, 3))),
    ("targets", np.zeros(3)),
    ("predicted_markers", np.zeros((2, 3))),
    ("measured_markers", np.zeros((4, 3))),
])
def test_an_array_unlike_the_stage_is_refused_by_name(stage, make_frame, key, value):
    with pytest.raises(ViewError) as refusal:
        make_frame(0, **{key: value}).refuse_if_unlike(stage)
    assert refusal.value.key == key
