"""Converted bodies against formulas, in the units of the file."""

import numpy as np
import pytest

TET = '''
def createScene(root):
    root.gravity = [20, -9000, 3000]
    body = root.addChild("body")
    body.addObject("{solver}")
    body.addObject("MeshTopology", position={points}, tetrahedra=[[0, 1, 2, 3]])
    body.addObject("MechanicalObject")
    body.addObject("UniformMass", totalMass={mass})
    body.addObject("TetrahedronFEMForceField", youngModulus=300, poissonRatio={ratio}, method="{method}")
    body{held}
    body{more}
'''
POINTS = np.array([[0.0, 0.0, 0.0], [50.0, 5.0, 0.0], [10.0, 40.0, -3.0], [12.0, 14.0, 45.0]])
HELD = '.addObject("FixedProjectiveConstraint", indices=[0, 1, 2])'


def corner_stiffness(young: float, ratio: float) -> np.ndarray:
    """Stiffness of the free corner of a linear tetrahedron, V (λ g gᵀ + µ g gᵀ + µ gᵀg 1), shape (3, 3)."""
    edges = POINTS[1:] - POINTS[0]
    g = np.linalg.inv(edges)[:, 2]
    mu, lame = young / (2 * (1 + ratio)), young * ratio / ((1 + ratio) * (1 - 2 * ratio))
    return abs(np.linalg.det(edges)) / 6.0 * ((lame + mu) * np.outer(g, g) + mu * (g @ g) * np.eye(3))


@pytest.fixture
def movement(convert, run_alone):
    """How far the points of the tetrahedron move [m], shape (4, 3)."""

    def run(mass=2e-5, ratio=0.3, method="small", held=HELD, more="", solver="StaticSolver", steps=5):
        text = TET.format(points=POINTS.tolist(), mass=mass, ratio=ratio, method=method, held=held, more=more,
                          solver=solver)  # fmt: skip
        simulation, _ = run_alone(convert("one_tet.py", text).scene, 0.01, steps)
        return simulation.state.positions - simulation.model.nodes.rest_positions

    return run


def deflection(stiffness: np.ndarray, mass: float) -> np.ndarray:
    """Movement of the free corner [mm]: a quarter of the mass hangs there; lengths in mm, forces in mN."""
    return np.linalg.solve(stiffness, mass / 4.0 * np.array([20.0, -9000.0, 3000.0]))


@pytest.mark.sampled
@pytest.mark.parametrize("method", ["small", "large", "polar"])
@pytest.mark.parametrize("ratio", [0.0, 0.3, 0.45])
def test_a_tetrahedron_yields_as_its_matrix_says(movement, method, ratio):
    expected = deflection(corner_stiffness(300.0, ratio), 2e-5)
    np.testing.assert_allclose(1e3 * movement(ratio=ratio, method=method)[3], expected, rtol=2e-3)


@pytest.mark.parametrize("mass, ratio, more, stiffness", [
    (2e-4, 0.3, '.addObject("RestShapeSpringsForceField", points=[3], stiffness=40.0)', 40.0 * np.eye(3)),
    (2e-5, 0.4, '.addChild("inner").addObject("TetrahedronFEMForceField", youngModulus=500, poissonRatio=0.1, '
     'method="small")', corner_stiffness(500.0, 0.1)),
], ids=["springs to the rest shape", "another force field"])  # fmt: skip
def test_what_acts_on_one_tetrahedron_adds_its_stiffness(movement, mass, ratio, more, stiffness):
    expected = deflection(corner_stiffness(300.0, ratio) + stiffness, mass)
    np.testing.assert_allclose(1e3 * movement(mass, ratio, more=more)[3], expected, rtol=2e-3)


def test_a_free_fall_in_time_is_that_of_backward_euler(movement):
    moved = movement(method="large", held="", solver="EulerImplicitSolver", steps=10)
    expected = 0.01**2 * 55 * np.array([0.02, -9.0, 3.0])  # g h² Σ k
    np.testing.assert_allclose(moved, np.tile(expected, (4, 1)), rtol=1e-6)
