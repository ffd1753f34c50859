"""The contact law: one contact alone, the explicit law and its Newton steps, the residual."""

import numpy as np
import pytest

from softrobot_twin.solvers import contact_proximal_newton as proximal
from softrobot_twin.solvers.contact_gauss_seidel import residual
from softrobot_twin.solvers.contact_law import (
    CONTACT_SIZE,
    admissible,
    law,
    measure_contact,
    natural_residual,
    solve_contact,
)
from softrobot_twin.solvers.contact_newton_step import apply_step

STEP = 1e-7


class Drawn:
    """A random law at a random place: open, sticking and sliding contacts, actuators."""

    def __init__(self, seed, per_contact=3, rank=9):
        random = np.random.default_rng(seed)
        self.actuators, self.contacts, self.per_contact = 3, 8, per_contact
        n = self.actuators + per_contact * self.contacts
        self.Yt = random.standard_normal((n, rank))
        self.W = self.Yt @ self.Yt.T
        self.own = np.diag(self.W).copy()
        if per_contact == 3:
            for k in range(self.actuators, n, 3):
                self.own[k + 1 : k + 3] = self.own[k + 1 : k + 3].mean()
        self.stiffness = 1.0 / (0.1 * self.own)
        self.violation, self.centre = random.standard_normal(n), random.standard_normal(n)
        self.bounds = (
            np.zeros(3), np.array([0.5, 2.0, np.inf]), random.uniform(0.1, 1.0, self.contacts),
            per_contact,
        )  # fmt: skip
        self.x = random.standard_normal(rank)

    def law(self, delta):
        force, slope = np.empty_like(delta), np.empty((len(delta), 3))
        law(delta, self.centre, self.stiffness, *self.bounds, force, slope)
        return force, slope

    def g(self, x):
        return x - self.Yt.T @ self.law(self.Yt @ x + self.violation)[0]

    def K(self, slope):
        """-dλ/dδ in full."""
        full = np.diag(slope[:, 0])
        if self.per_contact == 3:
            for n in range(self.actuators, len(slope), 3):
                full[n + 1, n + 1] = full[n + 2, n + 2] = 0.0
                full[n + 1 : n + 3, n] = slope[n + 1 : n + 3, 0]
                full[n + 1 : n + 3, n + 1 : n + 3] = slope[n + 1 : n + 3, 1:]
        return full


@pytest.mark.parametrize("per_contact", [1, 3])
@pytest.mark.parametrize("seed", range(12))
def test_slopes_are_those_of_finite_differences(seed, per_contact):
    drawn = Drawn(seed, per_contact)
    delta = drawn.Yt @ drawn.x + drawn.violation
    _, slope = drawn.law(delta)
    step = STEP * np.eye(len(delta))
    measured = np.array([
        (drawn.law(delta + s)[0] - drawn.law(delta - s)[0]) / (2.0 * STEP) for s in step
    ]).T  # fmt: skip
    np.testing.assert_allclose(drawn.K(slope), -measured, atol=1e-5 * drawn.stiffness.max())


@pytest.mark.parametrize("per_contact", [1, 3])
@pytest.mark.parametrize("seed", range(12))
def test_the_jacobian_is_that_of_finite_differences(seed, per_contact):
    drawn = Drawn(seed, per_contact)
    _, slope = drawn.law(drawn.Yt @ drawn.x + drawn.violation)
    matrix = np.empty((len(drawn.x),) * 2)
    proximal.fill_jacobian(drawn.Yt, slope, drawn.actuators, per_contact, matrix)
    step = STEP * np.eye(len(drawn.x))
    measured = np.array([(drawn.g(drawn.x + s) - drawn.g(drawn.x - s)) / (2 * STEP) for s in step])
    np.testing.assert_allclose(matrix, measured.T, atol=1e-5 * np.abs(matrix).max())


@pytest.mark.parametrize("per_contact", [1, 3])
@pytest.mark.parametrize("seed", range(12))
def test_the_step_on_the_rows_that_press_is_newtons(seed, per_contact):
    drawn = Drawn(seed, per_contact)
    multipliers = np.random.default_rng(100 + seed).standard_normal(len(drawn.violation))
    delta = drawn.W @ multipliers + drawn.violation
    force, slope = drawn.law(delta)
    g = multipliers - force
    n = len(g)
    rows, kinds, frame = np.empty(n, np.int64), np.empty(n, np.int64), np.empty((n, 4))
    count = proximal.pick_rows(
        slope, force, delta, drawn.centre, drawn.stiffness, g, drawn.bounds[2], drawn.actuators,
        per_contact, rows, kinds, frame,
    )  # fmt: skip
    known = drawn.W @ frame[:, 3]
    matrix, right = proximal.fill_reduced_system(
        drawn.W, g, known, drawn.stiffness, rows, kinds, frame, count
    )
    step = frame[:, 3].copy()
    apply_step(rows, kinds, frame, count, np.linalg.solve(matrix, right), step)
    expected = np.linalg.solve(np.eye(n) + drawn.K(slope) @ drawn.W, -g)
    np.testing.assert_allclose(step, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(20))
def test_the_residual_is_that_of_the_sweeps(seed):
    drawn = Drawn(seed)
    force = np.random.default_rng(seed).standard_normal(len(drawn.violation))
    admissible(*drawn.bounds, force)
    delta = drawn.W @ force + drawn.violation
    mine = natural_residual(drawn.own, delta, *drawn.bounds, force)
    np.testing.assert_allclose(mine, residual(drawn.W, *drawn.bounds, force, delta), rtol=1e-9)


@pytest.mark.parametrize("seed", range(50))
def test_projection_changes_no_bit_of_feasible_forces(seed):
    random = np.random.default_rng(seed)
    bounds = (np.zeros(2), np.ones(2), random.uniform(0.0, 2.0, 40), 3)
    force = random.standard_normal(122) * 10.0 ** random.uniform(-9, 9, 122)
    admissible(*bounds, force)
    again = force.copy()
    admissible(*bounds, again)
    np.testing.assert_array_equal(again, force)


def local_problem(seed, spread):
    rng = np.random.default_rng(seed)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    W = axes @ np.diag(spread ** np.linspace(0.0, 1.0, 3)) @ axes.T
    local = np.zeros(CONTACT_SIZE)
    measure_contact(W, 0, local)
    return W, local, rng


@pytest.mark.parametrize("friction", [1e-6, 0.1, 0.7, 10.0])
@pytest.mark.parametrize("spread", [1.0, 10.0, 1e4])
@pytest.mark.parametrize("seed", range(15))
def test_a_contact_obeys_signorini_and_coulomb_to_round_off(seed, spread, friction):
    W, local, rng = local_problem(seed, spread)
    q = rng.standard_normal(3)
    force = np.array(solve_contact(local, friction, *q))
    motion = W @ force + q
    size = np.abs(W).max() * np.abs(force).max() + np.abs(q).max()
    assert force[0] >= 0.0
    if q[0] >= 0.0:
        assert np.all(force == 0.0)
        return
    assert abs(motion[0]) < 1e-11 * size
    pull, limit = np.hypot(force[1], force[2]), friction * force[0]
    assert pull <= limit * (1.0 + 1e-12)
    if pull < limit * (1.0 - 1e-9):
        assert np.abs(motion[1:]).max() < 1e-11 * size
    else:
        # Along -force: no component across, and not in the opposite direction.
        assert abs(force[1] * motion[2] - force[2] * motion[1]) < 1e-10 * size * pull
        assert force[1] * motion[1] + force[2] * motion[2] <= 1e-10 * size * pull


def test_an_open_contact_has_no_force():
    _, local, _ = local_problem(0, 2.0)
    assert solve_contact(local, 0.5, 1e-3, 1.0, 1.0) == (0.0, 0.0, 0.0)


def test_without_friction_only_the_normal_force_acts():
    W, local, _ = local_problem(1, 2.0)
    assert solve_contact(local, 0.0, -1.0, 3.0, 1.0) == (1.0 / W[0, 0], 0.0, 0.0)
