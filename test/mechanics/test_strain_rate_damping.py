"""Facts of damping by the rate of strain: Rayleigh's at rest, objective everywhere."""

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.quadratic import add_mid_edge_nodes
from softrobot_twin.mechanics.consistent_inertia import ConsistentInertia
from softrobot_twin.mechanics.corotational import CorotationalTets
from softrobot_twin.mechanics.lumped_inertia import LumpedInertia
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.mechanics.nodal_masses import lumped_masses
from softrobot_twin.mechanics.quadratic_tets import QuadraticTets
from softrobot_twin.mechanics.quadrature import quadrature
from softrobot_twin.mechanics.strain_rate_damping import StrainRateDamping
from softrobot_twin.mechanics.strain_rate_kernels import THINNEST

YOUNG, POISSON, DENSITY = 2.0e5, 0.3, 1070.0
STEP, BETA = 0.004, 0.02
LAWS = {"linear": CorotationalTets, "quadratic": QuadraticTets}


def damping(mesh, free_index, lame, beta=BETA):
    return StrainRateDamping(mesh, free_index, lame, beta)


def lumped_inertia(mesh, free_index, _):
    nodes = np.flatnonzero(free_index >= 0)
    return LumpedInertia(nodes, free_index[nodes], lumped_masses(mesh, DENSITY)[nodes])


def consistent_inertia(mesh, free_index, _):
    return ConsistentInertia(mesh, free_index, DENSITY, np.flatnonzero(free_index >= 0))


@pytest.fixture(params=list(LAWS))
def element(request):
    return request.param


@pytest.fixture
def body(element, block):
    """Makes a box of elements of a kind that does not fill its batches."""

    def make(cells=(1, 2, 2)):
        mesh = block(cells=cells)
        return add_mid_edge_nodes(mesh) if element == "quadratic" else mesh

    return make


def moved(positions, amount, seed):
    return positions + amount * np.random.default_rng(seed).standard_normal(positions.shape)


def strained(mesh):
    """The box bent and pressed by tens of per cent, and turned."""
    x, y, z = mesh.node_positions.T
    bent = np.column_stack([0.8 * x + 1.5 * z * z, 1.2 * y, z + 0.6 * x * y])
    return bent @ Rotation.from_rotvec([0.4, -0.7, 0.9]).as_matrix().T


def begin(bound, positions, step=STEP, velocities=None):
    if velocities is None:
        velocities = np.zeros((len(bound.free), 3))
    for term in bound.terms:
        if hasattr(term, "begin_step"):
            term.begin_step(positions, velocities, step)


def torque(positions, forces):
    return np.cross(positions, forces).sum(axis=0)


def test_matrix_is_minus_the_derivative_of_the_force(body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON), fixed=[0, 3, 4])
    begin(bound, strained(mesh))
    x = moved(strained(mesh), 0.004, seed=2)
    forces, A = bound.assemble(x)
    np.testing.assert_array_equal(bound.forces(x)[0], forces)
    columns = []
    for node in bound.free:
        for axis in range(3):
            ahead, behind = x.copy(), x.copy()
            ahead[node, axis] += 1e-4
            behind[node, axis] -= 1e-4
            change = bound.forces(behind)[0] - bound.forces(ahead)[0]
            columns.append(change.ravel() / 2e-4)
    np.testing.assert_allclose(A.toarray(), np.column_stack(columns), atol=1e-9 * np.abs(A).max())


def test_force_is_the_viscous_stress_of_the_shape_where_the_step_begins(body, bind):
    mesh = body()
    start = strained(mesh)
    x = moved(start, 0.004, seed=2)
    bound = bind((damping, mesh, YOUNG, POISSON))
    # The step before must leave nothing behind.
    begin(bound, x, 2.0 * STEP)
    begin(bound, start)
    gradients, weights = quadrature(mesh)
    F0 = np.einsum("kai,kqaj->kqij", start[mesh.tets], gradients)
    F = np.einsum("kai,kqaj->kqij", x[mesh.tets], gradients)
    rate = (F @ np.linalg.inv(F0) - np.eye(3)) / STEP
    la, mu = lame_parameters(YOUNG, POISSON)
    trace = np.trace(rate, axis1=2, axis2=3)[..., None, None]
    stress = BETA * (la * trace * np.eye(3) + mu * (rate + rate.swapaxes(2, 3)))
    first = stress @ np.linalg.inv(F0).swapaxes(2, 3)
    nodal = np.einsum("k,kqij,kqaj->kai", weights, first, gradients)
    expected = np.zeros_like(x)
    np.add.at(expected, mesh.tets, -nodal)
    np.testing.assert_allclose(bound.forces(x)[0], expected, atol=1e-11 * np.abs(expected).max())


def test_at_rest_it_is_beta_times_the_elastic_stiffness(element, body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON), fixed=[1])
    plain = bind((LAWS[element], mesh, YOUNG, POISSON), fixed=[1])
    begin(bound, mesh.node_positions)
    K = plain.assemble(mesh.node_positions)[1].toarray()
    x = mesh.node_positions.copy()
    velocities = np.random.default_rng(0).standard_normal((len(bound.free), 3))
    x[bound.free] += velocities * STEP
    forces, A = bound.assemble(x)
    np.testing.assert_allclose(A.toarray(), BETA / STEP * K, atol=1e-12 * np.abs(A).max())
    expected = -BETA * (K @ velocities.ravel())
    np.testing.assert_allclose(forces.ravel(), expected, atol=1e-11 * np.abs(expected).max())


def test_it_takes_power_from_every_motion_of_every_shape(body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON))
    for seed in range(10):
        # The largest turn half of the elements inside out.
        start = moved(mesh.node_positions, 0.02 * seed, seed)
        begin(bound, start)
        for amount in (1e-5, 1e-2, 1.0):
            x = moved(start, amount, seed + 100)
            assert np.sum(bound.forces(x)[0] * (x - start)) < 0.0
        A = bound.assemble(start)[1].toarray()
        assert np.linalg.eigvalsh(A).min() > -1e-10 * np.abs(A).max()


def test_translation_of_a_strained_body_is_not_damped(body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON))
    start = strained(mesh)
    begin(bound, start)
    scale = np.abs(bound.forces(1.1 * start)[0]).max()
    assert np.abs(bound.forces(start + [0.3, -0.2, 0.1])[0]).max() < 1e-12 * scale
    assert not bound.forces(start)[0].any()


def test_turning_a_strained_body_is_damped_to_second_order_only(body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON))
    start = strained(mesh)
    begin(bound, start)

    def turned(angle):
        x = start @ Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_matrix().T
        forces = bound.forces(x)[0]
        power = np.sum(forces * (x - start)) / STEP
        return np.abs(forces).max(), -power, np.linalg.norm(torque(x, forces))

    coarse, fine = np.array(turned(0.02)), np.array(turned(0.01))
    # Force θ², power θ⁴, torque about where the nodes are θ³.
    np.testing.assert_allclose(np.log2(coarse / fine), [2.0, 4.0, 3.0], atol=0.01)


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["upright", "inside out"])
def test_no_motion_gives_a_torque_about_where_the_body_began(side, body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON))
    start = side * strained(mesh)
    begin(bound, start)
    forces = bound.forces(moved(start, 0.05, seed=4))[0]
    scale = np.linalg.norm(np.cross(start, forces), axis=1).sum()
    assert np.abs(torque(start, forces)).max() < 1e-12 * scale
    assert np.abs(forces.sum(axis=0)).max() < 1e-12 * np.abs(forces).sum()


def stepped(bound, start, velocities, step=STEP):
    """Where a step of backward Euler leads, Newton's method converged to round-off."""
    begin(bound, start, step, velocities)
    x = start.copy()
    x[bound.free] += step * velocities
    for _ in range(30):
        forces, A = bound.assemble(x)
        move = np.linalg.solve(A.toarray(), forces.ravel()).reshape(-1, 3)
        x[bound.free] += move
        if np.abs(move).max() < 1e-14:
            return x
    raise AssertionError("Newton's method did not converge")


def test_a_strained_body_that_spins_freely_keeps_its_angular_momentum(element, body, bind):
    mesh = body()
    masses = lumped_masses(mesh, DENSITY)[:, None]
    start = strained(mesh)
    velocities = np.cross([3.0, -5.0, 8.0], start - start.mean(axis=0))
    velocities = moved(velocities, 0.1, seed=3)
    before = torque(start, masses * velocities)
    elastic, inertia = ((law, mesh, YOUNG, POISSON) for law in (LAWS[element], lumped_inertia))
    viscous = (damping, mesh, YOUNG, POISSON)
    plain = bind(elastic)
    changes = []
    for parts in ((inertia, viscous), (inertia, elastic, viscous), (inertia, elastic)):
        x = stepped(bind(*parts), start, velocities)
        changes.append(torque(x, masses * (x - start) / STEP) - before)
        # What remains is backward Euler's own: the elastic force at the step's end.
        if elastic in parts:
            changes[-1] -= STEP * torque(start, plain.forces(x)[0])
    assert np.abs(changes).max() < 1e-11 * np.linalg.norm(before)


def test_a_cantilevers_first_mode_dies_away_at_half_beta_omega_squared(body, bind):
    mesh = body((1, 1, 3))
    fixed = np.flatnonzero(mesh.node_positions[:, 2] < 1e-9)
    parts = ((CorotationalTets if len(mesh.tets[0]) == 4 else QuadraticTets, mesh, YOUNG, POISSON),
             (consistent_inertia, mesh, 1.0, 0.0))  # fmt: skip
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
        x = moved(start, 0.01, seed=5)
        forces, A = bound.assemble(x)
        assert np.isfinite(forces).all() and np.sum(forces * (x - start)) < 0.0
        assert 0.0 < A.diagonal().sum() <= THINNEST**2 * rest


def test_motion_of_fixed_nodes_strains_the_elements_they_hold(body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON), fixed=[0, 1])
    whole = bind((damping, mesh, YOUNG, POISSON))
    for both in (bound, whole):
        begin(both, mesh.node_positions)
    x = mesh.node_positions.copy()
    x[:2] += [0.01, 0.0, -0.02]
    forces = bound.forces(x)[0]
    assert np.abs(forces).max() > 0.0
    np.testing.assert_array_equal(forces, whole.forces(x)[0][2:])


def test_without_a_step_or_in_an_endless_one_there_is_no_damping(body, bind):
    mesh = body()
    bound = bind((damping, mesh, YOUNG, POISSON), fixed=[2])
    x = strained(mesh)
    for step in (None, STEP, np.inf):
        if step is not None:
            begin(bound, mesh.node_positions, step)
        if step != STEP:
            forces, A = bound.assemble(x)
            assert not forces.any() and not A.toarray().any()


@pytest.mark.parametrize("beta", [-1.0, np.inf, np.nan])
def test_damping_that_cannot_be_is_refused(beta, block):
    mesh = block(cells=(1, 1, 1))
    with pytest.raises(ValueError, match="beta"):
        StrainRateDamping(mesh, np.arange(mesh.node_count), lame_parameters(1.0, 0.0), beta)
