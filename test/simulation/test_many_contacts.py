"""Many contacts with parallel normals on one face: solved, finite, the load shared."""

import meshio
import numpy as np
import pytest

from softrobot_twin.simulation import Hold
from test.scene_changes import solved

STEP, MASS, G = 0.004, 0.03, 9.81
TOLERANCE = 1e-8  # m


def slab_of(folder, mesh, points, height):
    """The entry of a slab with the surface of a mesh."""
    meshio.write(folder / "slab.stl", meshio.Mesh(points, [("triangle", mesh.surface_triangles)]))
    return {"name": "slab", "mass": MASS, "position": [0, 0, height],
            "surface": {"file": str(folder / "slab.stl")}}  # fmt: skip


@pytest.fixture
def slab(tmp_path, block):
    """A rigid slab of 40 mm by 40 mm, its sole cut into 14 by 14 cells: 225 corners."""
    mesh = block((0.04, 0.04, 0.02), (14, 14, 2), 0.0)
    return slab_of(tmp_path, mesh, mesh.node_positions - [0.02, 0.02, 0.01], 0.01)


@pytest.fixture
def studded_slab(tmp_path, block):
    """The same on 225 studs of 0.2 mm: on a flat sole only its corners could touch."""
    mesh = block((0.04, 0.04, 0.02), (30, 30, 1), 0.0)
    points = mesh.node_positions - [0.02, 0.02, 0.01]
    cells = np.rint((points[:, :2] + 0.02) / 0.04 * 30).astype(int)
    is_stud = (cells % 2 == 1).all(axis=1) & (points[:, 2] < 0.0)
    points[is_stud, 2] -= 2e-4
    return slab_of(tmp_path, mesh, points, 0.0102)


@pytest.mark.sampled
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_two_hundred_contacts_share_a_rigid_slabs_weight(scene_of, slab, friction):
    simulation = scene_of(
        integration="dynamic", rigid_bodies=[slab],
        obstacles=[{"name": "floor", "plane": {}}],
        contact={"friction": friction, "between": [{"pair": ["slab", "floor"]}]},
    )  # fmt: skip
    for _ in range(40):
        result = solved(simulation, Hold(STEP))
        forces = result.contacts.forces
        np.testing.assert_allclose(forces.sum(axis=0), [0, 0, MASS * G], atol=1e-6 * MASS * G)
        moment = np.cross(result.contacts.positions, forces).sum(axis=0)
        np.testing.assert_allclose(moment, 0.0, atol=1e-5 * MASS * G * 0.02)
        obeys_signorini_and_coulomb(simulation, result, friction)
    # The share of each is not unique, but none carries more than a few percent.
    assert forces[:, 2].max() < 0.05 * MASS * G


def obeys_signorini_and_coulomb(simulation, result, friction):
    """No force pulls or leaves the cone, none acts across a gap, nothing overlaps."""
    contacts, forces = simulation.model.contacts, result.contacts.forces
    count = contacts.count
    places = [np.flatnonzero((contacts.positions[:count] == at).all(axis=1))[0]
              for at in result.contacts.positions]  # fmt: skip
    normals = contacts.directions[places, 0]
    pressing = np.sum(forces * normals, axis=1)
    rubbing = np.linalg.norm(forces - pressing[:, None] * normals, axis=1)
    assert np.all(pressing > 0.0) and np.all(rubbing <= friction * pressing * (1.0 + 1e-9) + 1e-15)
    assert np.abs(result.contacts.gaps).max() < 2.0 * TOLERANCE
    assert contacts.gaps(simulation.state.positions).min() > -2.0 * TOLERANCE


@pytest.mark.exhaustive
def test_two_hundred_contacts_press_on_the_facets_of_a_soft_block(scene_of, soft_block, studded_slab):
    ground = soft_block("ground", (0.06, 0.06, 0.02), (1, 1, 1), [0, 0, -0.01], damping={"mass": 50.0},
                        fixed=[{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, -0.0199]}}])
    simulation = scene_of(
        integration="dynamic", rigid_bodies=[studded_slab], body=ground,
        contact={"friction": 0.5, "between": [{"pair": ["slab", "ground"]}]},
    )  # fmt: skip
    for _ in range(100):
        result = solved(simulation, Hold(STEP))
        # 675 rows, three for each of 225 points that all but coincide in their effect: how many
        # bear a force is not unique.
        forces = result.contacts.forces
        assert result.report.contact_residual < TOLERANCE
        assert result.report.contact_force_residual < 1e-6 * np.linalg.norm(forces, axis=1).max()
        # The ground is the first body of the pair: it is pressed down.
        obeys_signorini_and_coulomb(simulation, result, 0.5)
    np.testing.assert_allclose(forces.sum(axis=0), [0, 0, -MASS * G], atol=1e-3 * MASS * G)
    moment = np.cross(result.contacts.positions, forces).sum(axis=0)
    np.testing.assert_allclose(moment[:2], 0.0, atol=1e-3 * MASS * G * 0.02)
    # Which of them carry force is not unique, which are there is.
    assert simulation.model.contacts.count >= 200
    assert result.contacts.names == (("ground", "slab"),)
