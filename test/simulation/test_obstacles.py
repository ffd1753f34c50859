"""Obstacles of every kind bear what lies on them; open surfaces are refused by name."""

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.simulation import Hold, Status
from test.builder import builder

STEP, G = 0.004, 9.81
ENDS = [[-0.04, 0.0, 0.0], [0.04, 0.0, 0.0]]
# Each has its top at z = 0. Round ones are held from rolling off by being under the middle.
KINDS = {
    "plane": {"plane": {"normal": [0, 0, 2.0]}},
    "sphere": {"sphere": {"radius": 0.3, "centre": [0, 0, -0.3]}},
    "capsule": {"capsule": {"ends": ENDS, "radius": 0.05}, "position": [0, 0, -0.05]},
    "cylinder": {"cylinder": {"ends": ENDS, "radius": 0.05}, "position": [0, 0, -0.05]},
    "upright": {"cylinder": {"ends": [[0, 0, -0.1], [0, 0, 0]], "radius": 0.05}},
    "box": {"box": {"size": [0.1, 0.06, 0.02]}, "position": [0, 0, -0.01]},
    "turned": {"box": {"size": [0.1, 0.02, 0.06]}, "position": [0, 0, -0.01],
               "rotation": [np.pi / 2, 0, 0]},
}  # fmt: skip


@builder
def surface(tmp_path, block, /, kind, left_out=0) -> str:
    """Writes the surface of a box whose top is at z = 0, whole or with triangles left out."""
    mesh = block((0.1, 0.06, 0.02), (3, 3, 2))
    triangles = mesh.surface_triangles[left_out:]
    file = tmp_path / f"obstacle.{kind}"
    points = 1000.0 * (mesh.node_positions - [0.05, 0.03, 0.02])
    meshio.write(file, meshio.Mesh(points, [("triangle", triangles)]))
    return str(file)


def resting_on(scene_of, soft_block, obstacle, friction=0.5):
    return scene_of(
        integration="dynamic",
        body=soft_block("soft", (0.04, 0.04, 0.02), (4, 4, 2), [0, 0, 0.0105], damping={"mass": 30.0}),
        obstacles=[{"name": "obstacle", **obstacle}],
        contact={"friction": friction, "between": [{"pair": ["soft", "obstacle"]}]},
    )  # fmt: skip


def settles(simulation):
    for _ in range(250):
        result = simulation.step(Hold(STEP))
        assert result.status in (Status.OK, Status.LINEARIZED, Status.NOT_CONVERGED)
    weight = 0.04 * 0.04 * 0.02 * 1000.0 * G
    total = result.contacts.forces.sum(axis=0)
    np.testing.assert_allclose(total, [0, 0, weight], atol=0.02 * weight)
    contacts = simulation.model.contacts
    contacts.detect(result.state.positions)
    assert contacts.gaps(result.state.positions).min() > -1e-5
    assert np.abs(result.state.velocities).max() < 0.01


@pytest.mark.sampled
@pytest.mark.parametrize("kind", KINDS)
def test_a_soft_block_lies_on_an_obstacle(scene_of, soft_block, kind):
    settles(resting_on(scene_of, soft_block, KINDS[kind]))


@pytest.mark.parametrize("kind", ["stl", "obj", "ply"])
def test_a_soft_block_lies_on_a_closed_surface(scene_of, soft_block, surface, kind):
    entry = {"surface": {"file": surface(kind), "scale": 0.001}}
    settles(resting_on(scene_of, soft_block, entry))


def test_a_surface_with_a_hole_is_refused(scene_of, soft_block, surface):
    entry = {"surface": {"file": surface("stl", left_out=1), "scale": 0.001}}
    with pytest.raises(MeshError, match="obstacle.stl"):
        resting_on(scene_of, soft_block, entry)
