"""An obstacle that appears inside a body pushes it out at a bounded speed, without a burst."""

import meshio
import numpy as np
import pytest

from softrobot_twin.mechanics.inertia import lumped_masses
from softrobot_twin.simulation import Hold, Simulation, Status
from test.builder import builder
from test.scene_changes import repeat_step

STEP, PUSH_OUT = 0.002, 0.05
DEEP = 0.005
MATERIAL = {"young_modulus": 1.0e5, "poisson_ratio": 0.3, "density": 1000.0}
TOP_HELD = [{"box": {"minimum": [-1, -1, 0.0199], "maximum": [1, 1, 1]}}]


@builder
def obstacle(tmp_path, block, /, kind) -> dict:
    """Obstacles that reach 5 mm into a block on the plane z = 0."""
    if kind == "surface":
        mesh = block((0.06, 0.06, 0.03), (3, 3, 2))
        points = mesh.node_positions - [0.03, 0.03, 0.03]
        surface = meshio.Mesh(points, [("triangle", mesh.surface_triangles)])
        meshio.write(tmp_path / "solid.stl", surface)
        return {"position": [0.001, 0.002, DEEP], "surface": {"file": str(tmp_path / "solid.stl")}}
    return {
        "plane": {"plane": {}, "position": [0, 0, DEEP]},
        "sphere": {"sphere": {"radius": 0.05}, "position": [0, 0, DEEP - 0.05]},
        "cylinder": {"cylinder": {"ends": [[-0.03, 0, 0], [0.03, 0, 0]], "radius": 0.01},
                     "position": [0, 0.001, DEEP - 0.01]},
        "box": {"box": {"size": [0.06, 0.06, 0.03]}, "position": [0.001, 0.002, DEEP - 0.015]},
    }[kind]  # fmt: skip


def overlapping(scene_of, write_block, integration="dynamic", friction=0.0, **obstacle):
    file = write_block((0.04, 0.04, 0.02), (6, 6, 3))
    return scene_of(
        gravity=[0, 0, 0], integration=integration,
        body={"name": "soft", "mesh": {"file": file, "translation": [0, 0, 0.01]},
              "element": "linear",
              "material": MATERIAL, "damping": {"mass": 20.0}, "fixed": TOP_HELD},
        obstacles=[{"name": "solid", **obstacle}],
        contact={"friction": friction, "push_out_speed": PUSH_OUT,
                 "between": [{"pair": ["soft", "solid"]}]},
    )  # fmt: skip


def least_gap(simulation: Simulation) -> float:
    contacts = simulation.model.contacts
    contacts.detect(simulation.state.positions)
    return contacts.gaps(simulation.state.positions).min(initial=1.0)


@pytest.mark.sampled
@pytest.mark.parametrize("kind", ["plane", "sphere", "cylinder", "box", "surface"])
def test_a_deep_overlap_ends_at_the_push_out_speed(scene_of, write_block, obstacle, kind):
    simulation = overlapping(scene_of, write_block, **obstacle(kind))
    body, elastic = simulation.model.bodies[0], simulation.model.forces[0]
    masses = lumped_masses(body.mesh, MATERIAL["density"])[simulation.model.nodes.free_nodes]
    bound = PUSH_OUT * STEP
    gaps, kinetic, stored = [-DEEP], [], []
    for _ in range(int(1.5 * DEEP / bound)):
        result = simulation.step(Hold(STEP))
        assert result.status in (Status.OK, Status.LINEARIZED, Status.NOT_CONVERGED)
        gaps.append(least_gap(simulation))
        kinetic.append(0.5 * masses @ (result.state.velocities**2).sum(axis=1))
        stored.append(elastic.energy(result.state.positions))
    gaps = np.array(gaps)
    # The deepest point comes out as fast as it may, and no faster, until it is out.
    inside = gaps[: int(0.8 * DEEP / bound)]
    np.testing.assert_allclose(np.diff(inside), bound, rtol=0.25)
    assert gaps[-1] > -5e-4
    # Kinetic energy is a small part of the elastic energy of the overlap.
    assert max(kinetic) < 0.01 * max(stored)


def test_a_plane_that_appears_pushes_no_node_faster_than_the_push_out_speed(
    scene_of, write_block, obstacle
):
    simulation = overlapping(scene_of, write_block, **obstacle("plane"))
    for _ in range(75):
        result = simulation.step(Hold(STEP))
        assert result.status.is_success
        assert np.abs(result.state.velocities[:, 2]).max() < 1.02 * PUSH_OUT
    assert result.state.positions[:, 2].min() == pytest.approx(DEEP, abs=1e-7)


@pytest.mark.sampled
@pytest.mark.parametrize("integration", ["quasi_static", "first_order", "dynamic"])
def test_all_time_integrations_end_in_the_same_shape(scene_of, write_block, obstacle, integration):
    simulation = overlapping(scene_of, write_block, integration, **obstacle("plane"))
    result = repeat_step(simulation, Hold(STEP), 400)
    sole = simulation.model.nodes.rest_positions[:, 2] < 1e-9
    np.testing.assert_allclose(result.state.positions[sole, 2], DEEP, atol=1e-7)
    # A bar between plates, squeezed by a quarter: between free sides and a glued top.
    pressed = result.contacts.forces.sum(axis=0)[2]
    assert 1.0 < pressed / (MATERIAL["young_modulus"] * 0.04**2 * 0.25) < 1.5
    reference = overlapping(scene_of, write_block, **obstacle("plane"))
    expected = repeat_step(reference, Hold(STEP), 400)
    assert pressed == pytest.approx(expected.contacts.forces.sum(axis=0)[2], rel=1e-4)


def test_two_overlapping_soft_bodies_separate_at_a_bounded_speed(scene_of, write_block):
    file = write_block((0.04, 0.04, 0.02), (5, 5, 3))
    bodies = [
        {"name": name, "mesh": {"file": file, "translation": [shift, 0.7 * shift, z]},
         "element": "linear",
         "material": MATERIAL, "damping": {"mass": 5.0}}
        for name, z, shift in (("low", 0.01, 0.0), ("high", 0.025, 0.001))
    ]  # fmt: skip
    simulation = scene_of(
        gravity=[0, 0, 0], integration="dynamic", bodies=bodies,
        contact={"push_out_speed": PUSH_OUT, "between": [{"pair": ["low", "high"]}]},
    )
    assert least_gap(simulation) == pytest.approx(-DEEP, rel=0.05)
    fastest = 0.0
    for _ in range(150):
        result = simulation.step(Hold(STEP))
        centres = [result.state.positions[b.first_node : b.first_node + b.mesh.node_count, 2].mean()
                   for b in simulation.model.bodies]  # fmt: skip
        assert np.isfinite(result.state.positions).all()
        fastest = max(fastest, np.linalg.norm(result.state.velocities, axis=1).max())
    assert least_gap(simulation) > -1e-4
    assert centres[1] - centres[0] > 0.0199
    # Each body takes half; a node at an edge overshoots a little.
    assert fastest < 3.0 * PUSH_OUT
