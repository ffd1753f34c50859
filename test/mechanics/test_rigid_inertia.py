"""Facts of free rigid bodies' inertia."""

from typing import NamedTuple

import numpy as np
import pytest

from softrobot_twin.mechanics.gravity import Gravity
from softrobot_twin.mechanics.rigid_bodies import RigidDamping, RigidFrames, RigidInertia
from softrobot_twin.mechanics.rotation import rotation_from_vector
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU
from test.builder import builder

MASSES = [0.03, 2.0]
TURN = rotation_from_vector([0.3, -1.0, 0.5])
INERTIAS = [np.diag([1.0e-5, 2.0e-5, 2.8e-5]), TURN @ np.diag([0.1, 0.2, 0.25]) @ TURN.T]
UNKNOWNS = 5


class Bodies(NamedTuple):
    """Two free bodies behind one other unknown, and the terms that move them."""

    frames: RigidFrames
    terms: list
    matrix: SuperLU
    start: np.ndarray

    def forces(self, x):
        forces = np.zeros((UNKNOWNS, 3))
        for term in self.terms:
            assert term.add_forces(x, forces) == 0
        return forces

    def stiffness(self, x, projected=False):
        self.matrix.clear()
        added = np.zeros((UNKNOWNS, 3))
        for term in self.terms:
            term.add(x, added, self.matrix.storage, projected)
        np.testing.assert_array_equal(added, self.forces(x))
        return self.matrix.matrix().toarray()

    def step(self, x, velocities, h):
        """One step to convergence; gives the new velocities."""
        before = x.copy()
        for term in self.terms:
            if hasattr(term, "begin_step"):
                term.begin_step(before, velocities, h)
        size = 0.0
        for iteration in range(60):
            residual = self.forces(x).ravel()[3:]
            size = max(size, np.abs(residual).max())
            if np.abs(residual).max() <= 2e-15 * size:
                break
            A = self.stiffness(x, projected=iteration % 8 == 7)[3:, 3:]
            move = np.concatenate([np.zeros(3), np.linalg.solve(A, residual)]).reshape(-1, 3)
            self.frames.advance(x, move, 1.0)
        out = np.zeros((UNKNOWNS, 3))
        self.frames.displacement(before, x, out)
        return out / h


@builder
def bodies(*more):
    frames = RigidFrames(2, [True, False, True], 1, UNKNOWNS)
    inertia = RigidInertia(frames, MASSES, INERTIAS)
    terms = [inertia, *(term(frames) for term in more)]
    pairs = [stencil_pairs(term.stencils(), UNKNOWNS) for term in terms]
    matrix = SuperLU(*(np.concatenate(side) for side in zip(*pairs, strict=True)), UNKNOWNS)
    for term in terms:
        term.bind(matrix.elimination_rank, matrix.slots)
    poses = [
        (np.array([0.1, 0.2, 0.3]), rotation_from_vector([0.5, 0.2, 1.0])),
        (np.zeros(3), np.eye(3)),
        (np.array([-1.0, 0.0, 0.0]), rotation_from_vector([-1.5, 0.2, 0.3])),
    ]
    start = np.vstack([np.zeros((2, 3)), frames.rest_nodes(poses)])
    return Bodies(frames, terms, matrix, start)


@pytest.fixture
def speeds():
    return np.vstack([np.zeros(3), np.random.default_rng(3).standard_normal((4, 3)) * 4.0])


def tangent(bodies, x):
    """-∂forces/∂q by finite differences in translation and rotation."""
    step, slopes = 1e-6, []
    for unknown in range(UNKNOWNS):
        for axis in range(3):
            move = np.zeros((UNKNOWNS, 3))
            move[unknown, axis] = step
            ahead, behind = x.copy(), x.copy()
            bodies.frames.advance(ahead, move, 1.0)
            bodies.frames.advance(behind, move, -1.0)
            slopes.append((bodies.forces(behind) - bodies.forces(ahead)).ravel() / (2 * step))
    return np.array(slopes).T


@pytest.mark.parametrize("damped", [True, False])
@pytest.mark.parametrize("angle", [0.0, 0.01, 0.3, 1.5])
def test_stiffness_is_the_symmetric_part_of_the_forces_derivative(bodies, speeds, angle, damped):
    two = bodies(*[lambda frames: RigidDamping(frames, MASSES, INERTIAS, 7.0)] * damped)
    if not damped:
        # The inertia in the middle of the turn.
        two.terms[0].weight = 3.9
    for term in two.terms:
        term.begin_step(two.start, speeds, 0.01)
    x, move = two.start.copy(), np.random.default_rng(4).standard_normal((UNKNOWNS, 3))
    two.frames.advance(x, angle * move / np.linalg.norm(move, axis=1, keepdims=True), 1.0)
    slope, K = tangent(two, x), two.stiffness(x)
    largest = np.abs(K).max(axis=1, keepdims=True) + 1e-12
    np.testing.assert_allclose(K / largest, 0.5 * (slope + slope.T) / largest, atol=1e-6, rtol=1e-6)
    if damped:
        assert K[0, 0] == 0.0
    else:
        assert np.linalg.eigvalsh(two.stiffness(x, projected=True)[3:, 3:]).min() > 0.0


def test_accelerations_are_those_of_the_inertia_in_world_axes(bodies):
    two = bodies()
    inertia, forces = two.terms[0], np.random.default_rng(6).standard_normal((UNKNOWNS, 3))
    found = np.zeros((UNKNOWNS, 3))
    inertia.add_accelerations(two.start, forces, found)
    momenta = inertia.angular_momenta(two.start, found)
    np.testing.assert_allclose(momenta, forces[two.frames.rotations], rtol=1e-10)
    translations = two.frames.translations
    np.testing.assert_allclose(
        found[translations] * np.array(MASSES)[:, None], forces[translations], rtol=1e-12
    )


def test_carried_rates_keep_the_angular_momentum(bodies, speeds):
    two, inertia = bodies(), bodies().terms[0]
    after, move = two.start.copy(), np.random.default_rng(7).standard_normal((UNKNOWNS, 3))
    two.frames.advance(after, move, 1.0)
    rates = speeds.copy()
    inertia.carry_rates(two.start, after, rates)
    np.testing.assert_allclose(
        inertia.angular_momenta(after, rates), inertia.angular_momenta(two.start, speeds),
        rtol=1e-10,
    )  # fmt: skip
    np.testing.assert_array_equal(rates[two.frames.translations], speeds[two.frames.translations])
    middle, halfway = speeds.copy(), two.start.copy()
    two.frames.advance(halfway, move, 0.5)
    inertia.carry_rates(two.start, after, middle, in_middle=True)
    np.testing.assert_allclose(
        inertia.angular_momenta(after, middle), inertia.angular_momenta(halfway, speeds),
        rtol=1e-9,
    )  # fmt: skip


def test_the_projected_stiffness_is_positive_after_any_turn(bodies, speeds):
    two = bodies()
    two.terms[0].begin_step(two.start, speeds, 0.01)
    x, move = two.start.copy(), np.zeros((UNKNOWNS, 3))
    move[[2, 4]] = [[2.9, 0.3, 0.1], [-1.0, 2.0, 2.0]]
    two.frames.advance(x, move, 1.0)
    assert np.linalg.eigvalsh(two.stiffness(x, projected=True)[3:, 3:]).min() > 0.0


@pytest.mark.parametrize("h", [1e-3, 0.02])
def test_a_tumbling_body_keeps_momentum_and_angular_momentum(bodies, speeds, h):
    two = bodies()
    x, v = two.start.copy(), speeds
    start = two.terms[0].angular_momenta(x, v)
    for _ in range(100):
        v = two.step(x, v, h)
        np.testing.assert_allclose(v[[1, 3]], speeds[[1, 3]], atol=1e-12)
    now = two.terms[0].angular_momenta(x, v)
    size = np.linalg.norm(start, axis=1, keepdims=True)
    # Rounding of φ, 1e-16 a step, is a speed of 1e-16/h.
    np.testing.assert_allclose(now / size, start / size, atol=1e-13 / h)


@pytest.mark.parametrize("h", [1e-3, 0.02, 0.06])
def test_energy_of_a_free_body_never_grows(bodies, speeds, h):
    two = bodies()
    x, v = two.start.copy(), speeds
    energies = [two.terms[0].kinetic_energy(x, v)]
    for _ in range(100):
        v = two.step(x, v, h)
        energies.append(two.terms[0].kinetic_energy(x, v))
    assert np.all(np.diff(energies) <= 1e-13 * energies[0])
    assert 0.3 * energies[0] < energies[-1] < energies[0]


def test_a_body_spun_about_its_middle_axis_tumbles_with_bounded_energy(bodies):
    two = bodies()
    x, v = two.start.copy(), np.zeros((UNKNOWNS, 3))
    _, R = two.frames.pose(x, 0)
    v[2] = R @ [1e-3, 10.0, 1e-3]
    start = two.terms[0].angular_momenta(x, v)[0]
    along = []
    for _ in range(600):
        v = two.step(x, v, 5e-3)
        _, R = two.frames.pose(x, 0)
        along.append(R[:, 1] @ v[2])
    assert min(along) < -1.0 and max(along) > 9.9
    assert np.linalg.norm(v[2]) <= 2.0 * 10.0
    now = two.terms[0].angular_momenta(x, v)[0]
    np.testing.assert_allclose(now, start, atol=1e-11 * np.linalg.norm(start))


def test_free_fall_is_the_sum_of_its_implicit_steps(bodies):
    gravity, h, steps = np.array([0.0, 0.0, -9.81]), 0.01, 50
    two = bodies(lambda frames: Gravity(np.array([0.0, MASSES[0], 0.0, MASSES[1], 0.0]), gravity))
    x, v = two.start.copy(), np.zeros((UNKNOWNS, 3))
    for _ in range(steps):
        v = two.step(x, v, h)
    np.testing.assert_allclose(v[[1, 3]], np.tile(steps * h * gravity, (2, 1)), rtol=1e-12)
    fallen = h * h * steps * (steps + 1) / 2 * gravity
    np.testing.assert_allclose((x - two.start)[[2, 10]], np.tile(fallen, (2, 1)), rtol=1e-12)
    np.testing.assert_allclose(v[[2, 4]], 0.0, atol=1e-12)


def test_damping_alone_slows_a_body_as_backward_euler_predicts(bodies, speeds):
    rate, h = 5.0, 0.01
    two = bodies(lambda frames: RigidDamping(frames, MASSES, INERTIAS, rate))
    x, v = two.start.copy(), speeds
    start = two.terms[0].angular_momenta(x, v)
    for _ in range(20):
        v = two.step(x, v, h)
    left = (1.0 + rate * h) ** -20
    np.testing.assert_allclose(v[[1, 3]], left * speeds[[1, 3]], rtol=1e-10)
    np.testing.assert_allclose(two.terms[0].angular_momenta(x, v), left * start, rtol=1e-8)
