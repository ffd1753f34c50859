import dataclasses

import numpy as np
import pytest

from softrobot_twin.view import Drawn, Entity, Plot, ViewError

pytestmark = pytest.mark.libraries

TRIANGLE = np.array([[0, 1, 2]])


@pytest.mark.parametrize("triangles, points", [
    (np.zeros((4, 3)), None), (np.zeros((4, 2), int), None), (np.array([[0, 1, -1]]), None),
    (TRIANGLE, np.zeros((2, 3))), (TRIANGLE, np.zeros((3, 2))),
])  # fmt: skip
def test_an_invalid_surface_is_refused_by_its_path(triangles, points):
    with pytest.raises(ViewError, match="of /obstacles/cube"):
        Entity("/obstacles/cube", "solid", triangles=triangles, points=points)


def test_two_things_at_one_path_are_refused_by_it(stage):
    for change in ({"entities": stage.entities * 2},
                   {"plots": (*stage.plots, Plot("again", "/plots/residual", ()))}):
        with pytest.raises(ViewError, match="two things have the same path"):
            dataclasses.replace(stage, **change)


STONE = Entity("/rigid_bodies/stone", "solid", triangles=TRIANGLE, points=np.eye(3))
FORCES = Entity("/contacts/forces", "arrows")


@pytest.mark.parametrize(("path", "drawn"), [
    ("/robot/surface/body", Drawn(np.zeros((3, 3)))),
    ("/robot/surface/body", Drawn(np.zeros((4, 2)))),
    ("/robot/cables", Drawn((), values=np.zeros(2))),
    ("/robot/cables", Drawn((np.eye(3),) * 2, values=np.zeros(3))),
    ("/robot/cables", Drawn((np.eye(3),) * 2)),
    ("/robot/effectors", Drawn(np.zeros((2, 3)))),
    ("/targets", Drawn(np.zeros(3))),
    ("/markers/predicted", Drawn(np.zeros((2, 3)))),
    ("/markers/measured", Drawn(np.zeros((4, 3)))),
    (STONE.path, Drawn(np.zeros((1, 3)), np.zeros(4))),
    (STONE.path, Drawn(np.zeros(3), np.zeros((1, 4)))),
    (FORCES.path, Drawn(np.zeros((2, 3)), np.zeros((1, 3)))),
    ("/ghosts", Drawn(np.zeros((1, 3)))),
])
def test_an_array_of_another_shape_than_the_stage_is_refused_by_path(stage, make_frame, path, drawn):
    with pytest.raises(ViewError, match=path):
        make_frame(0, {path: drawn}).check_against(
            dataclasses.replace(stage, entities=(*stage.entities, STONE, FORCES)))
