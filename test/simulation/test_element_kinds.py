"""An element that is defined here, outside the package: the linear tetrahedron with a bubble."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from softrobot_twin.analysis.mesh_error import MeshErrorEstimator, MeshErrorUnknown
from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.cell_mesh import CellMesh
from softrobot_twin.geometry.quadrature import barycentric_coordinates, tetrahedron_rule
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.element_kinds import register_element
from softrobot_twin.mechanics.inertia import ConsistentInertia
from softrobot_twin.simulation import CommandEfforts, FollowTargets
from test.registrations import taken_back
from test.scene_changes import repeat_step

BUBBLE_SHARE = 256.0 * 6.0 / 5040.0
"""∫b dV / V of the bubble b = 256 L₀ L₁ L₂ L₃."""


def bubble_values(L):
    bubble = 256.0 * L.prod(axis=1, keepdims=True)
    return np.hstack([L - 0.25 * bubble, bubble])


class BubbleTetrahedron:
    """Five nodes: N_a = L_a - b/4 at the corners, and b in the middle."""

    node_count = 5
    gradient_degree = None
    quadrature = tetrahedron_rule(5)

    def values(self, points):
        return bubble_values(barycentric_coordinates(points))

    def slopes(self, points):
        L = barycentric_coordinates(points)
        others = np.stack([np.delete(L, a, axis=1).prod(axis=1) for a in range(4)], axis=1)
        bubble = 256.0 * (others[:, 1:] - others[:, :1])[:, None]
        corners = np.vstack([np.full(3, -1.0), np.eye(3)]) - 0.25 * bubble
        return np.concatenate([corners, bubble], axis=1)


@dataclass(frozen=True, eq=False)
class BubbleMesh(CellMesh):
    """See `CellMesh`."""

    corner_mesh: TetMesh
    node_positions: np.ndarray
    cells: np.ndarray
    mid_edge_ends: np.ndarray

    shape_functions = BubbleTetrahedron()
    load_shares = np.array([0.25 * (1.0 - BUBBLE_SHARE)] * 4 + [BUBBLE_SHARE])

    @property
    def volumes(self):
        return self.corner_mesh.volumes

    @property
    def surface_triangles(self):
        return self.corner_mesh.surface_triangles

    def carriers(self, cells, barycentric_weights):
        return self.cells[cells], bubble_values(barycentric_weights)

    def renumbered(self, node_positions, first_node):
        return replace(
            self, corner_mesh=self.corner_mesh.renumbered(node_positions, first_node),
            node_positions=node_positions, cells=self.cells + first_node,
            mid_edge_ends=self.mid_edge_ends + first_node,
        )  # fmt: skip


def add_bubble_nodes(mesh: TetMesh) -> BubbleMesh:
    middles = mesh.node_positions[mesh.cells].mean(axis=1)
    inner = mesh.node_count + np.arange(mesh.cell_count)[:, None]
    return BubbleMesh(
        mesh, np.vstack([mesh.node_positions, middles]), np.hstack([mesh.cells, inner]), mesh.cells
    )


@pytest.fixture
def bubbles():
    """Registers the element under this name while a test runs."""
    with taken_back():
        register_element("bubble", add_bubble_nodes)
        yield


@pytest.fixture
def beam_of(beam):
    """Makes the beam of a kind of elements."""
    return lambda element: beam(lambda mapping: mapping["body"].update(element=element))


def test_a_scene_names_an_element_only_while_it_is_registered(beam_of):
    with pytest.raises(SceneError, match="body.element = 'bubble': must be one of linear, smoothed"):
        beam_of("bubble")
    with taken_back():
        register_element("bubble", add_bubble_nodes)
        assert beam_of("bubble").model.bodies[0].mesh.cells.shape[1] == 5


def test_an_element_that_is_registered_twice_is_refused(bubbles):
    with pytest.raises(ValueError, match="'bubble' is registered already"):
        register_element("bubble", add_bubble_nodes)


def test_each_cell_has_a_free_node_of_its_own_unless_it_is_held(bubbles, beam_of):
    (body,) = beam_of("bubble").model.bodies
    corners = body.mesh.corner_mesh
    assert body.mesh.node_count == corners.node_count + corners.cell_count
    held = body.fixed[: corners.node_count][corners.cells].all(axis=1)
    np.testing.assert_array_equal(body.fixed[corners.node_count :], held)
    assert body.mesh.volume == pytest.approx(4e-5)


def test_a_beam_of_it_bends_as_one_of_linear_elements(bubbles, beam_of):
    """The gradient of a bubble is zero on average: it adds nothing where strain is uniform."""

    def deflection(element):
        simulation = beam_of(element)
        rest = simulation.effector_positions()
        result = repeat_step(simulation, CommandEfforts(np.array([0.5, 0.0, 0.0, 0.0]), 0.1), 20)
        assert not result.status.is_failure and result.report.residual < 1e-6
        return np.linalg.norm(result.effector_positions - rest)

    linear, bubble, quadratic = map(deflection, ("linear", "bubble", "quadratic"))
    assert linear * (1.0 - 1e-9) < bubble < linear * (1.0 + 1e-3)
    assert quadratic > 2.0 * bubble


def test_it_is_brought_to_a_target(bubbles, beam_of):
    pulled, simulation = beam_of("bubble"), beam_of("bubble")
    result = repeat_step(pulled, CommandEfforts(np.array([0.5, 0.2, 0.0, 0.0]), 0.1), 20)
    target = result.effector_positions
    assert np.linalg.norm(target - simulation.effector_positions()) > 1e-4
    result = repeat_step(simulation, FollowTargets(target, 0.1), 20)
    assert result.effector_errors[0] < 1e-6


def test_its_mass_is_that_of_the_body(bubbles, beam):
    def heavy(mapping):
        mapping["body"].update(element="bubble", mass="consistent")
        mapping.update(gravity=[0.0, 0.0, -9.81], integration="dynamic")

    simulation = beam(heavy)
    inertia = next(t for t in simulation.model.forces if isinstance(t, ConsistentInertia))
    velocities = np.tile([0.0, 0.0, 1.0], (simulation.model.nodes.free_node_count, 1))
    free = simulation.model.nodes.free_node_count / simulation.model.nodes.rest_positions.shape[0]
    momentum = inertia.momentum(velocities)
    assert momentum[:2] == pytest.approx(0.0, abs=1e-12)
    assert 0.5 * free * 0.04 < momentum[2] < 0.04


def test_its_error_is_not_estimated(bubbles, beam_of):
    with pytest.raises(MeshErrorUnknown, match="the element bubble is not compared"):
        MeshErrorEstimator(beam_of("bubble").scene)
