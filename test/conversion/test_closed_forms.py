"""Converted bodies against formulas, in the units of the file."""

import numpy as np
import pytest

TET = '''
def createScene(root):
    root.gravity = [20, -9000, 3000]
    body = root.addChild("body")
    body.addObject("StaticSolver")
    body.addObject("MeshTopology", position={points}, tetrahedra=[[0, 1, 2, 3]])
    body.addObject("MechanicalObject")
    body.addObject("UniformMass", totalMass={mass})
    body.addObject("TetrahedronFEMForceField", youngModulus={young}, poissonRatio={ratio}, method="{method}")
    body.addObject("FixedProjectiveConstraint", indices=[0, 1, 2])
    {more}
'''
POINTS = np.array([[0.0, 0.0, 0.0], [50.0, 5.0, 0.0], [10.0, 40.0, -3.0], [12.0, 14.0, 45.0]])


def corner_stiffness(points: np.ndarray, corner: int, young: float, ratio: float) -> np.ndarray:
    """Stiffness of a corner of a linear tetrahedron, V (λ g gᵀ + µ g gᵀ + µ gᵀg 1), shape (3, 3)."""
    edges = points[1:] - points[0]
    gradients = np.linalg.inv(edges).T
    g = np.vstack([-gradients.sum(axis=0), gradients])[corner]
    mu, lame = young / (2 * (1 + ratio)), young * ratio / ((1 + ratio) * (1 - 2 * ratio))
    return abs(np.linalg.det(edges)) / 6.0 * ((lame + mu) * np.outer(g, g) + mu * (g @ g) * np.eye(3))


@pytest.mark.parametrize("method", ["small", "large", "polar"])
@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.45])
def test_a_tetrahedron_yields_as_its_matrix_says(convert, run_alone, method, ratio):
    mass, young = 2e-5, 300.0
    text = TET.format(points=POINTS.tolist(), mass=mass, young=young, ratio=ratio, method=method, more="")
    scene = convert("one_tet.py", text).scene
    simulation, _ = run_alone(scene, 0.01, 5)
    moved = simulation.state.positions[3] - simulation.model.nodes.rest_positions[3]
    # A quarter of the mass hangs at the free corner; lengths in mm, forces in mN.
    expected = np.linalg.solve(corner_stiffness(POINTS, 3, young, ratio),
                               mass / 4.0 * np.array([20.0, -9000.0, 3000.0]))
    np.testing.assert_allclose(1e3 * moved, expected, rtol=2e-3)


def test_springs_to_the_rest_shape_add_their_stiffness(convert, run_alone):
    spring = 40.0
    text = TET.format(points=POINTS.tolist(), mass=2e-4, young=300.0, ratio=0.3, method="small", more=(
        f'body.addObject("RestShapeSpringsForceField", points=[3], stiffness={spring})'))
    simulation, _ = run_alone(convert("held_tet.py", text).scene, 0.01, 5)
    moved = simulation.state.positions[3] - simulation.model.nodes.rest_positions[3]
    stiffness = corner_stiffness(POINTS, 3, 300.0, 0.3) + spring * np.eye(3)
    np.testing.assert_allclose(1e3 * moved, np.linalg.solve(stiffness, 5e-5 * np.array([20.0, -9000.0, 3000.0])),
                               rtol=2e-3)  # fmt: skip


def test_moduli_of_force_fields_on_one_tetrahedron_add_up(convert, run_alone):
    more = ('inner = body.addChild("inner")\n    inner.addObject("TetrahedronFEMForceField", youngModulus=500, '
            'poissonRatio=0.1, method="small")')
    text = TET.format(points=POINTS.tolist(), mass=2e-5, young=300.0, ratio=0.4, method="small", more=more)
    simulation, _ = run_alone(convert("two_fields.py", text).scene, 0.01, 5)
    moved = simulation.state.positions[3] - simulation.model.nodes.rest_positions[3]
    stiffness = corner_stiffness(POINTS, 3, 300.0, 0.4) + corner_stiffness(POINTS, 3, 500.0, 0.1)
    np.testing.assert_allclose(1e3 * moved, np.linalg.solve(stiffness, 5e-6 * np.array([20.0, -9000.0, 3000.0])),
                               rtol=2e-3)  # fmt: skip


def test_a_free_fall_in_time_is_that_of_backward_euler(convert, run_alone):
    text = TET.format(points=POINTS.tolist(), mass=2e-5, young=300.0, ratio=0.3, method="large", more="").replace(
        "StaticSolver", "EulerImplicitSolver").replace(
        'body.addObject("FixedProjectiveConstraint", indices=[0, 1, 2])', "")  # fmt: skip
    simulation, _ = run_alone(convert("falling.py", text).scene, 0.01, 10)
    moved = simulation.state.positions - simulation.model.nodes.rest_positions
    expected = 0.01**2 * 55 * np.array([0.02, -9.0, 3.0])  # g h² Σ k
    np.testing.assert_allclose(moved, np.tile(expected, (4, 1)), rtol=1e-6)
