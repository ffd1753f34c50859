"""A clasp bent into a C, whose upper arm sinks onto its lower one: found by search or named."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Simulation
from test.builder import builder
from test.cad_parts import need_gmsh
from test.scene_changes import repeat_step
from test.thin_walled_meshes import random_thin_walls

STEP, OPENING, RADIUS, ANGLE = 0.01, 0.0, 0.03, 5.9


def clasp_shape(x):
    """Bend a bar along x about the y axis; its ends face each other at the right."""
    turn = np.pi - x[:, 0] / 0.16 * ANGLE
    radius = RADIUS + x[:, 2]
    return np.column_stack([radius * np.cos(turn), x[:, 1], radius * np.sin(turn)])


@builder
def clasp(scene_of, write_block, /, **contact) -> Simulation:
    """Held at its lower half; its upper half is heavy and soft."""
    file = write_block((0.16, 0.01, 0.008), (24, 2, 2), clasp_shape)
    return scene_of(
        gravity=[0, 0, -9.81],
        body={"name": "clasp", "mesh": {"file": file},
              "element": "linear",
              "material": {"young_modulus": 3e4, "poisson_ratio": 0.3, "density": 1000.0},
              "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, -0.004]}}]},
        solver={"newton_iterations": 3},
        **({"contact": contact} if contact else {}),
    )  # fmt: skip


def settle(simulation):
    return repeat_step(simulation, Hold(STEP), 60)


def ends(simulation, positions):
    """Lowest point of the upper end's face, highest of the lower one's, along z [m]."""
    rest = simulation.model.nodes.rest_positions
    right = (rest[:, 0] > 0.02) & (np.abs(rest[:, 2]) < 0.012)
    upper, lower = right & (rest[:, 2] > 0.0), right & (rest[:, 2] < 0.0)
    return positions[upper, 2].min(), positions[lower, 2].max()


def test_without_contact_the_ends_pass_through_each_other(clasp):
    simulation = clasp()
    upper, lower = ends(simulation, settle(simulation).state.positions)
    assert upper < lower - 0.002


@pytest.mark.parametrize("friction", [0.0, 0.4])
def test_with_a_search_for_pairs_the_ends_come_to_rest_on_each_other(clasp, friction):
    simulation = clasp(between=[{"pair": ["clasp", "clasp"]}], friction=friction)
    assert settle(clasp()).contacts is None
    result = settle(simulation)
    assert result.report.contact_count > 0
    contacts = simulation.model.contacts
    contacts.detect(result.state.positions)
    assert contacts.gaps(result.state.positions).min() > -2e-5
    # Only the two faces touch, nothing that hangs together anyway.
    assert np.all(result.contacts.positions[:, 0] > 0.02)
    assert np.all(np.abs(result.contacts.positions[:, 2]) < 0.012)


def test_with_given_pairs_the_ends_come_to_rest_on_each_other(clasp):
    probe = clasp()
    rest = probe.model.nodes.rest_positions
    turn = np.pi + 0.5 * ANGLE * np.array([1.0, -1.0])
    faces = [[RADIUS * np.cos(t), 0.0, RADIUS * np.sin(t)] for t in turn]
    low, high = sorted(faces, key=lambda point: point[2])
    points = [{"point": [high[0] + shift, y, high[2]], "against": [low[0] + shift, 0.3 * y, low[2]]}
              for shift in (-0.004, 0.004) for y in (-0.005, 0.005)]  # fmt: skip
    simulation = clasp(points=points)
    result = settle(simulation)
    upper, lower = ends(simulation, result.state.positions)
    passing, passed = ends(probe, settle(probe).state.positions)
    assert result.report.contact_count > 0
    assert upper - lower > passing - passed + 0.002
    # Each named point is on its side of its triangle.
    contacts = simulation.model.contacts
    contacts.detect(result.state.positions)
    assert contacts.gaps(result.state.positions).min() > -2e-5
    assert rest.shape == result.state.positions.shape


@pytest.mark.parametrize("seed", range(20))
def test_a_body_with_thin_walls_rests_as_it_is_drawn(scene_of, tmp_path, seed):
    need_gmsh()
    import meshio

    element = ("linear", "smoothed", "quadratic")[seed % 3]
    points, cells = random_thin_walls(np.random.default_rng([62, seed]))
    file = tmp_path / "walls.vtk"
    meshio.write(file, meshio.Mesh(points, [("tetra", cells)]))
    simulation = scene_of(
        gravity=[0, 0, 0], contact={"between": [{"pair": ["walls", "walls"]}], "alarm_distance": 1e-3},
        body={"name": "walls", "mesh": {"file": str(file)}, "element": element,
              "material": {"young_modulus": 1e6, "poisson_ratio": 0.4, "density": 1000.0},
              "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [2e-3, 1, 1]}}]},
    )  # fmt: skip
    result = simulation.step(Hold(STEP))
    assert result.status.value == "ok", f"seed {seed}"
    rest = simulation.model.nodes.rest_positions
    assert np.abs(result.state.positions - rest).max() < 1e-9, f"seed {seed}"
