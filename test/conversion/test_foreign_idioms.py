"""What scenes of others write: grids, mappings elsewhere, regions, numbers of helper packages, odd entries."""

import re

import meshio
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.conversion.splib_numerics import NUMERICS, Quat, Vec3

def test_a_grid_is_between_the_ends_of_each_axis(convert):
    told = convert("mapped_grids.py").told
    assert re.search(r"body bar: 63 nodes, 60 × 20 × 20 mm, E 600 kPa", told)
    assert re.search(r"body beam: 81 nodes, 20 × 20 × 80 mm, E 900 kPa", told)


def test_a_region_may_be_what_others_leave(convert):
    fixed = convert("mapped_grids.py").scene.deformables[0].fixed[0]
    assert fixed.nodes == tuple(range(0, 63, 7))


def test_parts_of_a_body_that_a_mapping_joins_elsewhere_are_attached_and_fixed(convert):
    scene = convert("mapped_grids.py").scene
    beam = scene.deformables[1]
    assert beam.fixed[0].nodes == tuple(range(9))
    assert beam.attached[0].to == "frame" and beam.attached[0].nodes == tuple(range(27, 54))
    assert beam.element == "hexahedral" and beam.material.density == pytest.approx(1000.0)
    assert beam.mass == "consistent" and scene.rigid_bodies[0].position == (0.11, 0.01, 0.04)


def test_a_loader_places_points_that_a_state_takes_from_it_once(convert):
    plane = convert("pneumatic_fingers.py").scene.obstacles[0].plane
    assert plane.point[0] == pytest.approx(-0.122)


def test_an_entry_that_cannot_be_built_is_listed_and_the_others_are_kept(convert, folder):
    converted = convert("mapped_grids.py")
    assert re.search(r"CableConstraint +mapped_grids.py:33 +cannot be built here: lies .* outside the body", converted.told)
    (pull,) = converted.scene.cables
    np.testing.assert_allclose(pull.points, [[0.06, 0.01, 0.0], [0.04, 0.01, 0.0]], atol=1e-12)
    assert not (folder / "mapped_grids_commands.csv").exists()


def test_a_sparse_grid_has_the_cells_that_hold_a_part_of_the_shape(convert, folder, drawn_rng):
    converted = convert("sparse.scn")
    mesh = meshio.read(folder / "sparse_bricks.msh")
    centres = mesh.points[mesh.cells_dict["hexahedron"]].mean(axis=1)
    low, cell = -0.04, 4.08 / 8
    shares = drawn_rng.dirichlet(np.ones(4), 400000)[:, 1:]
    wanted = np.unique((((4.0 * shares) - low) / cell).astype(int), axis=0)
    found = np.unique(np.floor((centres - low) / cell).astype(int), axis=0)
    assert {*map(tuple, wanted)} <= {*map(tuple, found)}
    # No cell is farther from the shape than a sample may be.
    assert (centres.sum(axis=1) - 1.5 * cell <= 4.0).all() and len(found) < 8**3 / 2
    assert converted.scene.deformables[0].fixed[0].box.maximum == (5.0, 0.1, 5.0)


def test_numbers_of_the_helper_package_turn_as_rotations_do(drawn_rng):
    quats, vector = Rotation.random(2, random_state=3), drawn_rng.normal(size=3)
    one, other = (Quat(list(quat)) for quat in quats.as_quat())
    np.testing.assert_allclose(Vec3(*vector).rotateFromQuat(one), quats[0].apply(vector))
    np.testing.assert_allclose(Quat.product(one, other).getMatrix(), (quats[0] * quats[1]).as_matrix())
    np.testing.assert_allclose(Quat.product(one, one.getInverse()), [0, 0, 0, 1], atol=1e-12)
    # The example of the package's own page: axes that turn too.
    np.testing.assert_allclose(Quat.createFromEuler([-np.pi / 2, np.pi / 2, 0.0], "ryxz"), [0.5, -0.5, 0.5, 0.5])
    moved = NUMERICS["transformPositions"]([[1, 0, 0]], [1, 2, 3], eulerRotation=[0, 0, 90.0], scale=[2, 2, 2])
    np.testing.assert_allclose(moved, [[1, 4, 3]])
    assert Vec3(3.0).toList() == [3.0] * 3 and NUMERICS["vsub"]([3, 2], [1, 1]) == [2, 1]


def test_goals_without_an_actuator_give_no_file_of_targets(convert, folder):
    text = (folder / "centre.py").read_text()
    convert("centre.py")
    assert (folder / "centre_targets.csv").exists()
    convert("idle.py", re.sub(r"(?s)\n    \S+\.addObject\(\"(Cable|SurfacePressure|ForcePoint)\w+\".*?\)(?=\n)", "", text))
    assert not (folder / "idle_targets.csv").exists()
