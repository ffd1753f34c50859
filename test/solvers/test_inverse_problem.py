"""The inverse problem as it is stacked from the condensed blocks, with and without contacts."""

import numpy as np
import pytest

from softrobot_twin.solvers.inverse_problem import (
    InverseSystem,
    build_inverse_problem,
    with_effort_rows,
)
from softrobot_twin.solvers.pivoting import solve_by_pivoting


def mean_curvature(system, weights):
    """Mean over the actuators of the tracking term's curvature, each in its own unit 1/√W_ii."""
    columns = np.einsum("e,ea,ea->a", weights, system.W_ea, system.W_ea)
    return float(np.mean(columns / np.diag(system.W_aa)))


def build(robot, weights=None, energy_weight=1e-4, **changed):
    weights = np.ones(len(robot.system.effectors)) if weights is None else weights
    problem = build_inverse_problem(*robot.given(weights, energy_weight))
    return problem._replace(**changed)


def split(robot, z):
    actuators = len(robot.system.actuators)
    first = len(z) - robot.contacts
    return z[:actuators], z[actuators:first], z[first:]


@pytest.mark.parametrize("seed", range(5))
def test_rows_and_gaps_are_the_motions_of_the_condensed_system(robot_in_contact, seed):
    robot = robot_in_contact(seed, contacts=4, moves=2)
    problem, system = build(robot), robot.system
    z = np.random.default_rng(seed).standard_normal(14)
    tensions, moves, forces = split(robot, z)
    path = system.W_aa @ tensions + system.G_a @ moves + system.W_ac @ forces
    gaps = system.W_ac.T @ tensions + system.G_c @ moves + system.W_cc @ forces + system.gaps
    np.testing.assert_allclose(problem.A @ z, np.concatenate([path, moves]), atol=1e-15)
    np.testing.assert_allclose(problem.gaps(z), gaps, atol=1e-15)
    assert np.isinf(problem.row_upper[8:]).all() and np.isinf(problem.row_lower[8:]).all()
    np.testing.assert_array_equal(problem.upper[8:10], robot.contact_bounds.move_max)
    room = problem.row_upper[:8] - robot.bounds.displacement_max
    np.testing.assert_allclose(room, -system.actuators, atol=1e-15)


@pytest.mark.parametrize("seed", range(5))
def test_without_energy_the_objective_is_the_weighted_distance_to_the_target(robot_in_contact, seed):
    robot = robot_in_contact(seed, contacts=4, moves=2)
    weights, system = np.array([1.0, 2.0, 0.5]), robot.system
    problem = build(robot, weights, 0.0)
    generator = np.random.default_rng(seed)
    first, second = generator.standard_normal((2, 14))

    def distance(z):
        tensions, moves, forces = split(robot, z)
        left = system.W_ea @ tensions + system.G_e @ moves + system.W_ec @ forces
        left += system.effectors
        return 0.5 * left @ (weights * left)

    change = problem.objective(first) - problem.objective(second)
    change *= mean_curvature(system, weights)
    assert change == pytest.approx(distance(first) - distance(second), rel=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_the_energy_is_that_of_all_multipliers(robot_in_contact, seed):
    robot = robot_in_contact(seed, contacts=4, moves=0)
    z = np.random.default_rng(seed).standard_normal(12)
    tensions, _, forces = split(robot, z)
    system = robot.system
    work = tensions @ system.W_aa @ tensions + forces @ system.W_cc @ forces
    work += 2.0 * tensions @ system.W_ac @ forces
    work += 1e-3 * (np.diag(system.W_aa) @ tensions**2 + np.diag(system.W_cc) @ forces**2)
    change = build(robot, energy_weight=1e-2).P - build(robot, energy_weight=0.0).P
    assert z @ change @ z == pytest.approx(1e-2 * work, rel=1e-9)


def test_epsilon_has_the_same_meaning_with_and_without_contacts(robot_in_contact):
    robot = robot_in_contact(0, contacts=4, moves=1)
    system = InverseSystem.without_contacts(
        robot.system.W_ea, robot.system.W_aa, robot.system.effectors, robot.system.actuators
    )
    plain = build_inverse_problem(system, np.ones(3), 1e-3, robot.bounds)
    ours = build(robot, energy_weight=1e-3).P[:8, :8]
    np.testing.assert_allclose(ours, plain.P, rtol=1e-12, atol=1e-15 * np.abs(plain.P).max())


def test_the_hessian_is_positive_definite_with_duplicate_and_ineffective_actuators(robot_in_contact):
    robot = robot_in_contact(0, contacts=4, moves=1).with_contacts(np.array([0, 0, 1, 1, 2]))
    system = robot.system._replace(G_e=np.zeros((3, 1)))
    P = build(robot._replace(system=system), energy_weight=1e-6).P
    scale = 1.0 / np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P * np.outer(scale, scale)).min() > 1e-12


def test_with_nothing_to_track_the_robot_rests(robot_in_contact):
    robot = robot_in_contact(0, contacts=2, moves=1)
    wide = np.full(8, np.inf)
    robot = robot._replace(
        system=robot.system._replace(gaps=np.array([1.0, 1.0])),
        bounds=robot.bounds._replace(displacement_min=-wide, displacement_max=wide),
    )
    problem = build(robot, np.zeros(3))
    answer = solve_by_pivoting(problem, robot.held, robot.touching)
    assert answer.solved
    np.testing.assert_allclose(answer.unknowns, 0.0, atol=1e-12)


def test_a_platform_stops_at_an_obstacle_and_presses_no_harder_than_allowed(robot_in_contact):
    """The obstacle is 2 mm ahead, with compliance 1 mm/N; the target 10 mm, 1 N is allowed."""
    robot = robot_in_contact(0, contacts=1, moves=1, rows=1)
    system = robot.system._replace(
        W_ea=robot.system.W_ea[:, :0], W_ec=np.zeros((1, 1)), W_aa=np.zeros((0, 0)),
        W_ac=robot.system.W_ac[:0], W_cc=np.array([[1e-3]]), G_e=np.array([[1.0]]),
        G_a=np.zeros((0, 1)), G_c=np.array([[-1.0]]), effectors=np.array([-1e-2]),
        actuators=np.zeros(0), gaps=np.array([2e-3]),
    )  # fmt: skip
    bounds = type(robot.bounds)(*(bound[:0] for bound in robot.bounds))
    limits = robot.contact_bounds._replace(
        move_min=np.array([-2e-2]), move_max=np.array([2e-2]), force_max=np.array([1.0])
    )
    robot = robot._replace(
        system=system, bounds=bounds, contact_bounds=limits, tensions=np.zeros(0)
    )
    answer = solve_by_pivoting(build(robot, energy_weight=1e-6), robot.held, robot.touching)
    assert robot.touching.tolist() == [False] and answer.touching.tolist() == [True]
    assert answer.unknowns[0] == pytest.approx(3e-3, rel=1e-9)
    assert answer.unknowns[1] == pytest.approx(1.0, rel=1e-12)
    assert answer.force_excess.max() == 0.0


@pytest.mark.parametrize("contacts", [0, 4])
def test_the_proximal_term_weighs_the_energy_of_the_distance_from_its_centre(robot_in_contact, contacts):
    robot = robot_in_contact(0, contacts=contacts, moves=0)
    generator = np.random.default_rng(0)
    centre, first, second = generator.standard_normal((3, 8 + contacts))
    given = robot.given(np.ones(3), 1e-3)
    plain = build_inverse_problem(*given)
    near = build_inverse_problem(*given, centre, 9.0)
    energy = plain.P - build_inverse_problem(*robot.given(np.ones(3), 0.0)).P

    def added(z):
        return near.objective(z) - plain.objective(z)

    def distance(z):
        return 9.0 * 0.5 * (z - centre) @ energy @ (z - centre)

    expected = distance(first) - distance(second)
    assert added(first) - added(second) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("contacts", [0, 4])
def test_without_any_target_the_proximal_term_has_no_effect(robot_in_contact, contacts):
    robot = robot_in_contact(0, contacts=contacts, moves=0)
    given = robot.given(np.zeros(3), 1e-3)
    centre = np.random.default_rng(0).standard_normal(8 + contacts)
    plain, near = build_inverse_problem(*given), build_inverse_problem(*given, centre, 9.0)
    np.testing.assert_array_equal(near.P, plain.P)
    np.testing.assert_array_equal(near.g, plain.g)
    assert not near.g.any()


def augmented(system, stiffness, reference):
    """A system in λ̂ = λ + ρ (δ_a - δ_ref) in place of λ, by elimination of λ by hand."""
    W, rho = system.W_aa, np.diag(stiffness)
    M = np.linalg.inv(np.eye(len(W)) + rho @ W)
    shift = stiffness * (system.actuators - reference)
    hat = system._replace(
        W_ea=system.W_ea @ M, W_aa=W @ M,
        effectors=system.effectors - system.W_ea @ M @ shift,
        actuators=system.actuators - W @ M @ shift,
    )  # fmt: skip
    return hat, M, shift


@pytest.mark.parametrize("seed", range(10))
def test_with_effort_rows_the_optimum_is_that_of_the_problem_in_efforts(robot_in_contact, seed):
    """Without energy the objective is the same; with four rows the optimum of three is unique."""
    robot = robot_in_contact(seed, contacts=0, actuators=3, moves=0, rows=4)
    generator = np.random.default_rng(seed)
    stiffness = np.array([0.0, 1.0, 10.0]) / np.diag(robot.system.W_aa)
    reference = 1e-3 * generator.standard_normal(3)
    hat, M, shift = augmented(robot.system, stiffness, reference)
    plain = build(robot, np.ones(4), 0.0)
    problem = with_effort_rows(
        build_inverse_problem(hat.stacked, np.ones(4), 0.0, robot.bounds), stiffness, reference,
        hat.actuators,
    )  # fmt: skip
    start = robot.tensions
    expected = solve_by_pivoting(plain, start, robot.touching)
    found = solve_by_pivoting(problem, np.linalg.solve(M, start) + shift, robot.touching)
    assert expected.solved and found.solved
    efforts = M @ (found.unknowns - shift)
    np.testing.assert_allclose(efforts, expected.unknowns, atol=1e-6)
    displacements = hat.W_aa @ found.unknowns + hat.actuators
    np.testing.assert_allclose(
        efforts, found.unknowns - stiffness * (displacements - reference), atol=1e-9
    )


@pytest.mark.parametrize("seed", range(5))
def test_effort_rows_admit_exactly_the_efforts_within_their_bounds(robot_in_contact, seed):
    """With contacts and moves, which may displace the actuators too."""
    robot = robot_in_contact(seed, contacts=4, moves=2)
    system, generator = robot.system.stacked, np.random.default_rng(seed)
    count, own = len(system.actuators), np.diag(robot.system.W_aa)
    stiffness = generator.permutation(np.resize([0.0, 1.0, 10.0], len(own))) / own
    stiffness = np.pad(stiffness, (0, 2))
    reference = 1e-3 * generator.standard_normal(count)
    problem = build(robot)
    changed = with_effort_rows(problem, stiffness, reference, system.actuators)
    shifted = stiffness > 0.0
    assert len(changed.A) == count + np.count_nonzero(shifted)
    np.testing.assert_array_equal(changed.A[:count], problem.A)
    np.testing.assert_array_equal(changed.P, problem.P)
    for z in 5.0 * generator.standard_normal((20, len(problem.g))):
        efforts = z[:count] - stiffness * (problem.A @ z + system.actuators - reference)
        rows = changed.A[count:] @ z
        at_least, at_most = rows - changed.row_lower[count:], changed.row_upper[count:] - rows
        lower, upper = problem.lower[:count], problem.upper[:count]
        np.testing.assert_allclose(at_least, (efforts - lower)[shifted], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(at_most, (upper - efforts)[shifted], rtol=1e-9, atol=1e-9)
    free = np.concatenate([shifted, np.zeros(len(problem.g) - count, dtype=bool)])
    assert np.isinf(changed.lower[free]).all() and np.isinf(changed.upper[free]).all()
    np.testing.assert_array_equal(changed.lower[~free], problem.lower[~free])
    np.testing.assert_array_equal(changed.upper[~free], problem.upper[~free])
