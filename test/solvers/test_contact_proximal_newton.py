"""Facts of the proximal Newton: contacts that few unknowns carry, and Newton steps on W itself."""

import numpy as np
import pytest

from softrobot_twin.solvers.contact_gauss_seidel import ContactGaussSeidel, residual
from softrobot_twin.solvers.contact_problem import ContactProblem
from softrobot_twin.solvers.contact_proximal_newton import ContactProximalNewton

GAP, SHARE, STEP = 1e-8, 1e-6, 0.004
NONE = np.zeros(0)


def bodies(seed, contacts=40, count=3, per_contact=3, actuators=0, ratio=1e3):
    """Cubes of very different masses that touch each other and the ground with random points.

    Their normals differ by some 20 degrees, as on uneven ground.
    """
    random = np.random.default_rng(seed)
    n, rank = actuators + per_contact * contacts, 6 * count
    masses = 0.03 * 10.0 ** random.uniform(0.0, np.log10(ratio), count)
    Yt = np.zeros((n, rank))
    for k in range(contacts):
        rows = slice(actuators + per_contact * k, actuators + per_contact * (k + 1))
        below = random.integers(-1, count - 1)
        normal = [0.0, 0.0, 1.0] + 0.2 * random.standard_normal(3)
        normal /= np.linalg.norm(normal)
        tangent = np.cross(normal, [1.0, 0.0, 0.0])
        tangent /= np.linalg.norm(tangent)
        axes = np.array([normal, tangent, np.cross(normal, tangent)])[:per_contact]
        for body, sign in ((below + 1, 1.0), (below, -1.0)):
            if body >= 0:
                Yt[rows, 6 * body : 6 * body + 6] = sign * of_cube(
                    axes, [*random.uniform(-0.02, 0.02, 2), -0.02 * sign], masses[body]
                )
    for k in range(actuators):
        axis, body = random.standard_normal((1, 3)), random.integers(count)
        pulled = of_cube(axis, random.uniform(-0.02, 0.02, 3), masses[body])
        Yt[k, 6 * body : 6 * body + 6] = pulled
    violation = Yt @ (STEP * np.sqrt(np.repeat(masses, 6)) * random.uniform(-10, 10, rank))
    # A motion that leaves every gap open exists: so does a solution, whatever the friction.
    violation[actuators::per_contact] += 1e-4 * random.random(contacts)
    return ContactProblem(
        None, violation, np.zeros(actuators), np.full(actuators, 50.0),
        random.uniform(0.0, 1.0, contacts), per_contact, Yt,
    )  # fmt: skip


def of_cube(axes, point, mass):
    """Rows of H along axes at a point of a cube of 40 mm, by the root of h² / M."""
    levers = np.cross(point, axes) / np.sqrt(0.04**2 / 6.0)
    return STEP / np.sqrt(mass) * np.concatenate([axes, levers], axis=1)


def judged(problem, multipliers):
    """Residual [m], and in newtons as a share of the largest force, by the package's own map."""
    W = problem.Yt @ problem.Yt.T
    delta = W @ multipliers + problem.violation
    gap, newtons = residual(
        W, problem.lower, problem.upper, problem.friction, problem.rows_per_contact, multipliers,
        delta,
    )  # fmt: skip
    return gap, newtons / max(np.abs(multipliers).max(), 1e-300)


def solve(problem, guess=None):
    guess = np.zeros(len(problem.violation)) if guess is None else guess
    return ContactProximalNewton(GAP, SHARE).solve(problem, guess)


def test_random_bodies_are_solved_to_a_millionth_of_the_largest_force():
    for seed in range(100):
        problem = bodies(seed)
        found = solve(problem)
        gap, share = judged(problem, found.multipliers)
        assert found.converged, f"seed {seed}: {gap} m, {share}"
        assert gap <= 1.01 * GAP and share <= 1.01 * SHARE, f"seed {seed}: {gap} m, {share}"


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("per_contact, actuators", [(1, 0), (3, 0), (1, 3), (3, 3)])
def test_signorini_coulomb_and_bounds_hold(seed, per_contact, actuators):
    problem = bodies(seed, 30, 2, per_contact, actuators)
    found = solve(problem)
    assert found.converged
    delta = problem.Yt @ (problem.Yt.T @ found.multipliers) + problem.violation
    pulled, moved = found.multipliers[:actuators], delta[:actuators]
    assert np.all((pulled >= 0.0) & (pulled <= 50.0))
    assert np.all(moved[pulled > 0.0] < 2 * GAP) and np.all(moved[pulled < 50.0] > -2 * GAP)
    force = found.multipliers[actuators:].reshape(-1, per_contact)
    motion = delta[actuators:].reshape(-1, per_contact)
    largest = force.max(initial=0.0)
    assert np.all(force[:, 0] >= 0.0) and motion[:, 0].min() >= -2 * GAP
    assert np.abs(motion[force[:, 0] > 1e-4 * largest, 0]).max(initial=0.0) <= 2 * GAP
    if per_contact == 3:
        limit = problem.friction * force[:, 0]
        rubbing = np.hypot(force[:, 1], force[:, 2])
        assert np.all(rubbing <= limit * (1.0 + 1e-12))
        slides = (np.hypot(motion[:, 1], motion[:, 2]) > 1e-4) & (limit > 1e-3 * largest)
        np.testing.assert_allclose(rubbing[slides], limit[slides], rtol=1e-3)
        against = np.sum(force[slides, 1:] * motion[slides, 1:], axis=1)
        assert np.all(against < 0.0)


@pytest.mark.parametrize("seed", range(10))
def test_bodies_move_as_by_the_matrix_where_their_motion_is_unique(seed):
    # Without friction the forces of redundant contacts are not unique, what they do is.
    problem = bodies(seed, 30, 2, per_contact=1, ratio=10.0)
    found = solve(problem)
    other = solve(problem.with_matrix())
    assert found.converged and other.converged
    moves = [problem.Yt.T @ one.multipliers for one in (found, other)]
    np.testing.assert_allclose(*moves, atol=1e-5 * np.abs(moves[0]).max())


@pytest.mark.parametrize("seed", range(10))
def test_newton_on_the_matrix_solves_problems_that_sweeps_do_not(seed):
    low = bodies(seed, contacts=30)
    problem = low.with_matrix()
    assert problem.Yt is None
    swept = ContactGaussSeidel(GAP, 60).solve(problem, np.zeros(len(problem.violation)))
    found = solve(problem, swept.multipliers)
    gap, share = judged(low, found.multipliers)
    assert found.converged and gap <= 1.01 * GAP and share <= 1.01 * SHARE


def test_a_contact_without_compliance_has_zero_force():
    problem = bodies(5)
    Yt, violation = problem.Yt.copy(), problem.violation.copy()
    Yt[:3], violation[:3] = 0.0, [1e-4, 0.0, 0.0]
    guess = np.ones(len(violation))
    found = solve(problem._replace(Yt=Yt, violation=violation), guess)
    assert found.converged
    np.testing.assert_array_equal(found.multipliers[:3], 0.0)
    violation[0] = -1e-3
    found = solve(problem._replace(Yt=Yt, violation=violation), guess)
    assert not found.converged and np.isfinite(found.multipliers).all()


def test_an_infeasible_problem_is_not_reported_as_solved():
    # One body between two walls that are 1 mm too close to each other.
    Yt = 0.03 * np.array([[1.0], [-1.0]])
    problem = ContactProblem(None, np.full(2, -5e-4), NONE, NONE, np.zeros(2), 1, Yt)
    found = solve(problem)
    assert not found.converged and np.isfinite(found.multipliers).all()
    assert found.gap_residual > 1e-4


@pytest.mark.parametrize("where", ["Yt", "violation", "guess"])
def test_a_non_finite_problem_has_no_solution_and_a_finite_answer(where):
    problem, guess = bodies(2), np.full(120, 0.25)
    if where == "guess":
        guess[4] = np.nan
    else:
        broken = getattr(problem, where).copy()
        broken[4] = np.inf
        problem = problem._replace(**{where: broken})
    found = solve(problem, guess)
    assert not found.converged and np.isfinite(found.multipliers).all()
