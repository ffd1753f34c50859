"""Facts of damping by the rate of strain: Rayleigh's at rest, blind to rotation everywhere."""

import numpy as np
import pytest
from scipy.linalg import eigh, polar
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.quadratic_mesh import add_mid_edge_nodes
from softrobot_twin.geometry.shape_functions import integration_points
from softrobot_twin.mechanics.inertia import lumped_masses
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.mechanics.strain_rate_damping import THINNEST, StrainRateDamping

from .test_inertia import DENSITY, consistent, lumped
from .test_mass_damping import displaced
from test.builder import builder, each_of

YOUNG, POISSON = 2.0e5, 0.3
STEP, BETA = 0.004, 0.02


def damping(mesh, free_index, lame, beta=BETA):
    return StrainRateDamping(mesh, free_index, lame, beta)


element = each_of(["linear", "quadratic"])


@builder
def body(element, block, /, cells=(1, 2, 2)):
    """Makes a box of elements of a kind that does not fill its batches."""
    mesh = block(cells=cells)
    return add_mid_edge_nodes(mesh) if element == "quadratic" else mesh


def strained(mesh):
    """The box bent and pressed by tens of per cent, and turned."""
    x, y, z = mesh.node_positions.T
    bent = np.column_stack([0.8 * x + 1.5 * z * z, 1.2 * y, z + 0.6 * x * y])
    return bent @ Rotation.from_rotvec([0.4, -0.7, 0.9]).as_matrix().T


def begin(bound, positions, step=STEP, velocities=None):
    if velocities is None:
        velocities = np.zeros((len(bound.free), 3))
    for term in bound.terms:
        term.begin_step(positions, velocities, step)


def turned(positions, degrees):
    """Turned about an axis through the origin."""
    angle = np.radians(degrees)
    return positions @ Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_matrix().T


def torque(positions, forces):
    return np.cross(positions, forces).sum(axis=0)


@pytest.mark.parametrize("angle", [0.0, 30.0, 90.0, 170.0])
def test_matrix_is_minus_the_derivative_of_the_force(angle, body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON), fixed=[0, 3, 4])
    begin(bound, strained(mesh))
    # Stretches of some per cent in the step, beside the rotation.
    x = turned(displaced(strained(mesh), 0.004, seed=2), angle)
    forces, A = bound.assemble(x)
    np.testing.assert_array_equal(bound.forces(x)[0], forces)
    A = A.toarray()
    np.testing.assert_allclose(A, -bound.slopes_of_forces(x), atol=2e-8 * np.abs(A).max())
    np.testing.assert_allclose(A, A.T, atol=1e-13 * np.abs(A).max())


@pytest.mark.parametrize("projected", [False, True])
def test_where_a_step_begins_the_matrix_is_the_derivative_and_there_is_no_force(projected, body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON), fixed=[0, 3, 4])
    x = strained(mesh)
    begin(bound, x)
    forces, A = bound.assemble(x, projected)
    assert not forces.any()
    A = A.toarray()
    np.testing.assert_allclose(A, -bound.slopes_of_forces(x), atol=2e-8 * np.abs(A).max())
    # The general law tells the same an instant later.
    later = bound.assemble(np.nextafter(x, np.inf), projected)[1].toarray()
    np.testing.assert_allclose(A, later, atol=1e-12 * np.abs(A).max())


def test_the_projected_matrix_is_never_indefinite(body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON))
    begin(bound, strained(mesh))
    least = []
    for seed in range(5):
        # Pressed and sheared in one step until the exact tangent is indefinite.
        x = turned(displaced(0.8 * strained(mesh), 0.02, seed), 40.0)
        for projected in (False, True):
            A = bound.assemble(x, projected)[1].toarray()
            least.append(np.linalg.eigvalsh(A).min() / np.abs(A).max())
    assert min(least[0::2]) < -1e-3
    assert min(least[1::2]) > -1e-10


def test_force_is_the_viscous_stress_in_the_elements_own_frame(body, bind):
    mesh = body()
    start = strained(mesh)
    x = turned(displaced(start, 0.004, seed=2), 50.0)
    bound = bind((damping, mesh, YOUNG, POISSON))
    # The step before must leave nothing behind.
    begin(bound, x, 2.0 * STEP)
    begin(bound, start)
    gradients, weights = integration_points(mesh.node_positions, mesh.cells, mesh.shape_functions)
    F0 = np.einsum("kai,kqaj->kqij", start[mesh.cells], gradients)
    F = np.einsum("kai,kqaj->kqij", x[mesh.cells], gradients) @ np.linalg.inv(F0)
    nodal = np.zeros((*mesh.cells.shape, 3))
    la, mu = lame_parameters(YOUNG, POISSON)
    heat = 0.0
    for k, q in np.ndindex(F.shape[:2]):
        R, U = polar(F[k, q])
        rate = (U - np.eye(3)) / STEP
        stress = BETA * (la * np.trace(rate) * np.eye(3) + 2.0 * mu * rate)
        heat += weights[k, q] * STEP * np.sum(stress * rate)
        nodal[k] += weights[k, q] * gradients[k, q] @ np.linalg.inv(F0[k, q]) @ (R @ stress).T
    expected = np.zeros_like(x)
    np.add.at(expected, mesh.cells, -nodal)
    np.testing.assert_allclose(bound.forces(x)[0], expected, atol=1e-11 * np.abs(expected).max())
    assert bound.terms[0].heat(x) == pytest.approx(heat, rel=1e-10)


def test_at_rest_it_is_beta_times_the_elastic_stiffness(element, body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON), fixed=[1])
    plain = bind(("corotational", mesh, YOUNG, POISSON), fixed=[1])
    begin(bound, mesh.node_positions)
    K = plain.assemble(mesh.node_positions)[1].toarray()
    velocities = 1e-5 * np.random.default_rng(0).standard_normal((len(bound.free), 3))
    _, A = bound.assemble(mesh.node_positions)
    np.testing.assert_allclose(A.toarray(), BETA / STEP * K, atol=1e-12 * np.abs(A).max())
    x = mesh.node_positions.copy()
    x[bound.free] += velocities * STEP
    expected = -BETA * (K @ velocities.ravel())
    forces = bound.forces(x)[0].ravel()
    np.testing.assert_allclose(forces, expected, atol=1e-5 * np.abs(expected).max())


def test_dissipation_is_positive_for_any_shape_and_motion(body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON))
    viscous = bound.terms[0]
    for seed in range(10):
        # The largest turn half of the elements inside out.
        start = displaced(mesh.node_positions, 0.02 * seed, seed)
        begin(bound, start)
        assert viscous.heat(start) == 0.0
        for amount in (1e-5, 1e-2, 1.0):
            assert viscous.heat(displaced(start, amount, seed + 100)) > 0.0
        A = bound.assemble(start)[1].toarray()
        assert np.linalg.eigvalsh(A).min() > -1e-10 * np.abs(A).max()


def test_the_work_against_the_damping_force_is_half_the_dissipation_on_any_path(body, bind):
    """The potential of the force: what it takes to go from where the step begins."""
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON))
    start = strained(mesh)
    begin(bound, start)
    points, weights = np.polynomial.legendre.leggauss(8)
    ends = [start, turned(start, 40.0), turned(displaced(start, 0.004, seed=6), 40.0)]
    work = 0.0
    for first, last in zip(ends[:-1], ends[1:], strict=True):
        for point, weight in zip(0.5 * (points + 1.0), 0.5 * weights, strict=True):
            force = bound.forces(first + point * (last - first))[0]
            work -= weight * np.sum(force * (last - first))
    assert work == pytest.approx(0.5 * bound.terms[0].heat(ends[-1]), rel=1e-5)


@pytest.mark.parametrize("angle", [1.0, 10.0, 30.0, 60.0, 90.0, 135.0, 180.0])
@pytest.mark.parametrize("side", [1.0, -1.0], ids=["upright", "inside out"])
def test_rotation_of_a_strained_body_is_not_damped_at_any_angle(angle, side, body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON))
    start = side * strained(mesh)
    begin(bound, start)
    x = turned(start, angle)
    assert np.abs(bound.forces(x)[0]).max() < 1e-12 * np.abs(bound.forces(1.1 * start)[0]).max()
    assert bound.terms[0].heat(x) < 1e-24 * bound.terms[0].heat(1.1 * start)
    # And no more is it stiff against turning further.
    forces, A = bound.assemble(x)
    spin = np.cross([0.3, 0.5, -0.7], x)
    assert np.linalg.norm(A @ spin.ravel()) < 1e-11 * np.abs(A).max() * np.linalg.norm(spin)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["upright", "inside out"])
def test_the_damping_force_has_no_resultant_or_torque_for_any_motion(side, body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON))
    start = side * strained(mesh)
    begin(bound, start)
    x = turned(displaced(start, 0.05, seed=4), 70.0)
    forces = bound.forces(x)[0]
    scale = np.linalg.norm(np.cross(x, forces), axis=1).sum()
    assert np.abs(torque(x, forces)).max() < 1e-12 * scale
    assert np.abs(forces.sum(axis=0)).max() < 1e-12 * np.abs(forces).sum()


def stepped(bound, start, velocities, step=STEP, tolerance=1e-14):
    """Where a step of backward Euler leads, Newton's method converged to round-off."""
    begin(bound, start, step, velocities)
    x = start.copy()
    x[bound.free] += step * velocities
    for _ in range(30):
        forces, A = bound.assemble(x)
        move = np.linalg.solve(A.toarray(), forces.ravel()).reshape(-1, 3)
        x[bound.free] += move
        if np.abs(move).max() < tolerance:
            return x
    raise AssertionError("Newton's method did not converge")


@pytest.mark.parametrize("degrees", [10.0, 30.0, 60.0, 90.0])
def test_a_body_that_spins_freely_keeps_its_angular_momentum(degrees, element, body, bind):
    """Whatever it turns by in a step: what damping adds to backward Euler's own loss.

    Without damping the step of a soft body loses 1.4 % of it at 10° and 44 % at 90°. Viscosity of
    100 times the elasticity (β/h) changes the loss by less than 0.1 %: it delays the centrifugal
    strain, up to 1 %, and nothing resists the turning.
    """
    mesh = body()
    masses = lumped_masses(mesh, DENSITY)[:, None]
    start = mesh.node_positions - mesh.node_positions.mean(axis=0)
    axis, stiff = np.array([0.6, 0.0, 0.8]), 3000.0 * YOUNG
    velocities = np.cross(np.radians(degrees) / STEP * axis, start)
    before = torque(start, masses * velocities)
    elastic = ("corotational", mesh, stiff, POISSON)
    inertia = (lumped, mesh, stiff, POISSON)
    after = []
    for beta in (0.0, STEP, 100.0 * STEP):
        viscous = (lambda *given, beta=beta: damping(*given, beta), mesh, stiff, POISSON)
        bound = bind(inertia, elastic, viscous)
        x = stepped(bound, start, velocities, tolerance=1e-12)
        after.append(torque(x, masses * (x - start) / STEP))
        assert bound.terms[2].heat(x) >= 0.0
    for damped in after[1:]:
        assert np.linalg.norm(damped - after[0]) < 1e-3 * np.linalg.norm(before)


def test_a_cantilevers_first_mode_decays_at_half_beta_omega_squared(body, bind):
    mesh = body((1, 1, 3))
    fixed = np.flatnonzero(mesh.node_positions[:, 2] < 1e-9)
    parts = (("corotational", mesh, YOUNG, POISSON), (consistent, mesh, 1.0, 0.0))
    plain = bind(*parts, fixed=fixed)
    still = np.zeros((len(plain.free), 3))
    begin(plain, mesh.node_positions, np.inf, still)
    K = plain.assemble(mesh.node_positions)[1].toarray()
    begin(plain, mesh.node_positions, 1.0, still)
    M = plain.assemble(mesh.node_positions)[1].toarray() - K
    squares, modes = eigh(K, M, subset_by_index=[0, 0])
    omega, mode = np.sqrt(squares[0]), modes[:, 0]
    beta, step = 0.2 / omega, 0.02 / omega

    def decay(bound):
        """Rate [1/s], from the product of the two roots of the mode's recursion."""
        x, velocities, amplitudes = mesh.node_positions.copy(), still, []
        x[bound.free] += 1e-4 * mode.reshape(-1, 3) / np.abs(mode).max()
        for _ in range(25):
            before = x
            x = stepped(bound, before, velocities, step)
            velocities = (x - before)[bound.free] / step
            amplitudes.append(mode @ M @ (x - mesh.node_positions)[bound.free].ravel())
        a = np.array(amplitudes)
        _, product = np.linalg.lstsq(np.column_stack([a[1:-1], -a[:-2]]), a[2:], rcond=None)[0]
        return -np.log(product) / (2.0 * step)

    viscous = (lambda *given: damping(*given, beta), mesh, YOUNG, POISSON)
    damped = bind(*parts, viscous, fixed=fixed)
    # Backward Euler alone damps by ω²h/2; both together as its recursion says.
    both = np.log1p(omega**2 * step * (beta + step)) / (2.0 * step)
    assert decay(damped) == pytest.approx(both, rel=1e-2)
    assert decay(damped) - decay(plain) == pytest.approx(0.5 * beta * omega**2, rel=0.02)


@pytest.mark.parametrize("share", [0.3, 0.05, 1e-12, 0.0, -1.0])
def test_a_crushed_or_inverted_body_is_damped_by_a_bounded_matrix(share, body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON))
    begin(bound, mesh.node_positions)
    rest = bound.assemble(mesh.node_positions)[1].diagonal().sum()
    for flattened in ([1.0, 1.0, share], [share, share, share]):
        start = mesh.node_positions * flattened
        begin(bound, start)
        x = displaced(start, 0.01, seed=5)
        forces, A = bound.assemble(x)
        assert np.isfinite(forces).all() and np.sum(forces * (x - start)) < 0.0
        assert 0.0 < A.diagonal().sum() <= THINNEST**2 * rest
