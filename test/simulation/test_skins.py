"""Surfaces by which bodies, rigid bodies and obstacles are drawn."""

import meshio
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.geometry.surface_reading import read_surface
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.mechanics.cavity_surfaces import surface_area
from softrobot_twin.simulation import Simulation, State
from softrobot_twin.view.drawn_parts import rigid_skins
from test.builder import builder
from test.places import SCENES


@pytest.fixture(scope="module")
def grasper():
    file = SCENES / "grasper.yaml"
    return Simulation(scene_from_mapping(yaml.safe_load(file.read_text()), file))


@pytest.fixture
def fine_surface(tmp_path):
    """Makes a surface file finer than the coarse Diamond, swollen by a factor about its middle."""
    fine = meshio.read(SCENES.parents[1] / "meshes" / "diamond_2700.vtk")

    def make(swelling=1.0, scale=1.0):
        triangles = boundary_triangles(fine.cells_dict["tetra"])
        middle = fine.points.mean(axis=0)
        points = (middle + swelling * (fine.points - middle)) / scale
        path = tmp_path / "fine.stl"
        meshio.write(path, meshio.Mesh(points, [("triangle", triangles)]), binary=True)
        return path

    return make


@builder
def dressed(diamond, /, path, scale=1.0, element="linear"):
    """Makes a Diamond that carries a surface file; also of quadratic elements."""
    return diamond({"body.visual": {"file": str(path), "scale": scale}, "body.element": element})


def moved(simulation, rotation, shift):
    positions = rotation.apply(simulation.model.nodes.rest_positions) + shift
    state = simulation.state
    simulation.restore(State(positions, state.setpoints.copy(), state.efforts.copy()))


@pytest.mark.sampled
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
def test_a_carried_surface_at_rest_is_the_one_of_the_file(fine_surface, dressed, element):
    path = fine_surface(swelling=1.05)
    simulation = dressed(path, element=element)
    points, triangles = read_surface(path)
    (drawn,), count = simulation.skin_positions(), len(points)
    assert drawn[:count] == pytest.approx(points, abs=1e-12)
    # Where its triangles are larger than the elements they are split, in their own planes.
    assert surface_area(drawn, simulation.skins[0].triangles) == pytest.approx(
        surface_area(points, triangles), rel=1e-9)
    assert count > len(simulation.surface_positions())


@pytest.mark.sampled
@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
def test_a_rigid_motion_of_the_mesh_moves_the_surface_rigidly(fine_surface, dressed, element):
    simulation = dressed(fine_surface(swelling=1.05), element=element)
    rest = simulation.skin_positions()[0]
    rotation, shift = Rotation.from_euler("xyz", [0.4, -1.1, 2.0]), [0.3, -0.2, 0.1]
    moved(simulation, rotation, shift)
    assert simulation.skin_positions()[0] == pytest.approx(rotation.apply(rest) + shift, abs=1e-12)


def test_a_surface_is_placed_like_its_mesh(fine_surface, diamond):
    path = fine_surface(scale=1e-3)

    def change(mapping):
        mapping["body"]["mesh"] |= {"rotation": [0.0, 0.0, 0.5], "translation": [1.0, 0.0, 0.0]}
        mapping["body"]["visual"] = {"file": str(path), "scale": 1e-3}
        for key in ("cables", "effectors", "markers"):
            mapping.pop(key)
        mapping["body"]["fixed"] = [{"nodes": [0, 1, 2, 3]}]

    simulation = diamond(change)
    (points,), own = simulation.skin_positions(), simulation.surface_positions()
    assert points.min(axis=0) == pytest.approx(own.min(axis=0), abs=3e-3)
    assert points.max(axis=0) == pytest.approx(own.max(axis=0), abs=3e-3)


def test_a_surface_in_the_wrong_unit_is_refused_by_its_key(fine_surface, dressed):
    with pytest.raises(SceneError, match=r"body\.visual\.file.*scale"):
        dressed(fine_surface(), scale=1000.0)


def test_each_body_is_drawn_by_its_own_surface_at_its_position(grasper):
    grasper.reset()
    assert [skin.name for skin in grasper.skins] == ["finger_0", "finger_1", "finger_2"]
    points = grasper.skin_positions()
    assert sum(map(len, points)) == len(grasper.surface_positions())
    angles = [np.arctan2(*part.mean(axis=0)[[1, 0]]) for part in points]
    turns = np.rad2deg(np.diff(np.unwrap(angles)))
    assert turns == pytest.approx([120.0, 120.0], abs=0.5)


def test_a_rigid_body_s_pose_places_its_shape(grasper):
    grasper.reset()
    positions, quaternions = grasper.rigid_poses()
    assert grasper.rigid_names == ("palm", "cube") and grasper.guided_names == ("palm",)
    cube = rigid_skins(grasper.model)[1]
    assert np.ptp(cube.points, axis=0) == pytest.approx([0.04] * 3)
    assert positions[1] == pytest.approx([0.0, 0.0, -0.104])
    assert quaternions[1] == pytest.approx(Rotation.from_euler("z", 0.785398).as_quat())
    corners = Rotation.from_quat(quaternions[1]).apply(cube.points) + positions[1]
    assert np.abs(corners[:, 0]).max() == pytest.approx(0.02 * np.sqrt(2.0))
    assert corners[:, 2].min() == pytest.approx(-0.124)


def test_a_shape_away_from_its_body_s_origin_stays_at_its_place_in_the_scene():
    """A free body's frame sits in its centre of mass; its entry's coordinates do not."""
    mapping = {
        "name": "stone", "integration": "dynamic",
        "rigid_bodies": [{"name": "stone", "mass": 0.1, "position": [1.0, 0.0, 0.0],
                          "rotation": [0.0, 0.0, np.pi / 2],
                          "box": {"centre": [0.3, 0.0, 0.0], "size": [0.2, 0.1, 0.1]}}],
    }  # fmt: skip
    simulation = Simulation(scene_from_mapping(mapping))
    (position,), (quaternion,) = simulation.rigid_poses()
    points = rigid_skins(simulation.model)[0].points
    assert position == pytest.approx([1.0, 0.0, 0.0])
    assert points[:, 0].min() == pytest.approx(0.2) and points[:, 0].max() == pytest.approx(0.4)
    placed = Rotation.from_quat(quaternion).apply(points) + position
    assert placed.mean(axis=0) == pytest.approx([1.0, 0.3, 0.0])
