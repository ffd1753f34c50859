"""Surface files of obstacles and rigid bodies that are missing or inside out."""

import meshio
import pytest

from test.shapes import Box
from softrobot_twin.simulation import Hold
from test.builder import builder
from test.scene_changes import solved

TOUCHING = {"friction": 0.5, "between": [{"pair": ["cube", "floor"]}]}


@builder
def flipped(tmp_path, /, name, centre, size):
    """Writes a box inside out; gives the file."""
    points, triangles = Box(centre, size).surface(0.03)
    path = tmp_path / name
    meshio.write(path, meshio.Mesh(points, [("triangle", triangles[:, ::-1])]), binary=True)
    return str(path)


def test_flipped_surfaces_of_obstacles_and_rigid_bodies_are_reversed_and_reported_once(scene_of, flipped):
    floor = {"name": "floor",
             "surface": {"file": flipped("rock.stl", [0, 0, -0.05], [0.2, 0.2, 0.1])}}  # fmt: skip
    cube = {"name": "cube", "mass": 0.03, "position": [0.003, 0.002, 0.02],
            "surface": {"file": flipped("dice.stl", [0, 0, 0], [0.04] * 3)}}  # fmt: skip
    simulation = scene_of(
        integration="dynamic", gravity=[0, 0, -9.81], rigid_bodies=[cube], obstacles=[floor],
        contact=TOUCHING,
    )  # fmt: skip
    for name in ("rock.stl", "dice.stl"):
        assert sum(f"{name}: reversed" in note for note in simulation.model.notes) == 1
    for _ in range(20):
        result = solved(simulation, Hold(0.004))
    assert result.contacts.of_pairs().resultants[0, 2] == pytest.approx(0.03 * 9.81, rel=1e-3)
