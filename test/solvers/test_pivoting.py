"""Facts of the quadratic program with complementarity, solved by single pivoting."""

import itertools

import daqp
import numpy as np
import pytest

from softrobot_twin.solvers.inverse_qp import build_qp
from softrobot_twin.solvers.daqp_solver import DAQPSolver
from softrobot_twin.solvers.pivoting import Stationarity, solve_by_pivoting

LOCAL_MINIMA = {Stationarity.STRONG, Stationarity.BOULIGAND}
ADMISSIBLE = 1.0e-9


def solve(robot, problem=None, **options):
    problem = robot.problem() if problem is None else problem
    return solve_by_pivoting(problem, robot.held, robot.touching, **options)


def least_of_all_pieces(problem) -> tuple[float, np.ndarray]:
    """The global optimum, by another way: contact forces eliminated from every piece."""
    n, count = len(problem.g), problem.contact_count
    best, best_z = np.inf, None
    for piece in itertools.product((False, True), repeat=count):
        found = least_of_one(problem, np.array(piece), n - count)
        if found is not None and problem.objective(found) < best:
            best, best_z = problem.objective(found), found
    return best, best_z


def least_of_one(problem, touching, own):
    """z = E x + e with gaps of touching contacts zero; then a plain program in x."""
    E, e = np.zeros((len(problem.g), own)), np.zeros(len(problem.g))
    E[:own] = np.eye(own)
    forces = own + np.flatnonzero(touching)
    W = problem.C[np.ix_(touching, forces)]
    E[forces] = -np.linalg.solve(W, problem.C[touching][:, :own])
    e[forces] = -np.linalg.solve(W, problem.d[touching])
    H, f = E.T @ problem.P @ E, E.T @ (problem.P @ e + problem.g)
    rows = np.vstack([problem.A, problem.C[~touching], np.eye(len(e))[forces]]) @ E
    at_zero = np.concatenate([problem.A @ e, problem.gaps(e)[~touching], e[forces]])
    many = len(at_zero) - len(problem.row_lower)
    low = np.concatenate([problem.row_lower, np.zeros(many)]) - at_zero
    high = np.concatenate([problem.row_upper, np.full(many, 1e30)]) - at_zero
    scale = 1.0 / np.sqrt(np.diag(H))
    lengths = np.linalg.norm(rows * scale, axis=1)
    size = np.abs(f * scale).max()
    x, _, exit_flag, _ = daqp.solve(
        H * np.outer(scale, scale), f * scale / size, rows * scale / lengths[:, None],
        np.concatenate([problem.upper[:own] / scale, high / lengths]) / size,
        np.concatenate([problem.lower[:own] / scale, low / lengths]) / size,
        primal_tol=1e-10,
    )  # fmt: skip
    return E @ (x * scale * size) + e if exit_flag == 1 else None


@pytest.mark.parametrize("seed", range(25))
def test_an_answer_is_admissible_and_no_worse_than_holding(
    robot_in_contact, complementarity_residual, seed
):
    robot = robot_in_contact(seed)
    problem = robot.problem()
    answer = solve(robot, problem)
    assert answer.solved and answer.stationarity in LOCAL_MINIMA
    assert complementarity_residual(problem, answer.unknowns) < ADMISSIBLE
    assert np.all(answer.unknowns >= problem.lower) and np.all(answer.unknowns <= problem.upper)
    assert answer.row_excess.max() < 1e-12
    assert answer.objective <= answer.held_objective + 1e-12 * abs(answer.held_objective)


def test_without_contacts_it_is_the_inverse_qp(robot_in_contact):
    robot = robot_in_contact(0, contacts=0, moves=0)
    system = robot.system
    plain = build_qp(
        system.W_ea, system.W_aa, system.effectors, system.actuators, np.ones(3), 1e-3,
        robot.bounds,
    )  # fmt: skip
    expected = DAQPSolver(8).solve(plain)
    assert expected.solved
    answer = solve(robot, robot.problem(1e-3))
    np.testing.assert_allclose(answer.unknowns, expected.multipliers, atol=1e-5)


def compare_with_all_pieces(robots):
    """Shares of what could be gained over holding that are lost."""
    lost = []
    for robot in robots:
        problem = robot.problem()
        answers = [solve(robot, problem), solve(robot, problem, look_around=True)]
        least, _ = least_of_all_pieces(problem)
        gain = answers[0].held_objective - least
        lost.append([(answer.objective - least) / gain for answer in answers])
    return np.array(lost)


def tell(contacts, lost):
    for name, each in zip(("pivoting", "look around"), lost.T, strict=True):
        missed = each[each > 1e-6]
        print(
            f"{contacts} contacts, {name}: global in {np.mean(each < 1e-6):.1%} of {len(each)}, "
            f"else {missed.mean() if len(missed) else 0.0:.1%} of the gain lost in the mean, "
            f"{each.max():.1%} at most"
        )


@pytest.mark.parametrize("contacts", [1, 3, 5])
def test_the_local_minimum_is_nearly_always_the_global_one(robot_in_contact, contacts):
    lost = compare_with_all_pieces([robot_in_contact(seed, contacts) for seed in range(40)])
    tell(contacts, lost)
    # No answer is below the enumerated optimum: it is one.
    assert lost.min() > -1e-6
    assert np.mean(lost[:, 0] < 1e-6) >= 0.8
    assert np.mean(lost[:, 1] < 1e-6) >= 0.95
    assert np.all(lost[:, 1] <= lost[:, 0] + 1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("contacts", "problems"), [(2, 200), (4, 200), (6, 200), (8, 60), (10, 20)])
def test_more_local_minima_are_global_ones(robot_in_contact, contacts, problems):
    lost = compare_with_all_pieces([robot_in_contact(s, contacts) for s in range(problems)])
    tell(contacts, lost)
    assert lost.min() > -1e-6
    assert np.mean(lost[:, 0] < 1e-6) >= 0.8
    assert np.mean(lost[:, 1] < 1e-6) >= 0.95


def test_the_contact_lets_go_where_leaving_goes_lower(robot_in_contact):
    # One cable pulls towards a wall and another away from it; the target is away.
    robot = robot_in_contact(0, contacts=1, actuators=2, moves=0, rows=1)
    eye = 1e-3 * np.eye(1)
    system = robot.system._replace(
        W_ea=np.array([[1e-3, -1e-3]]), W_ec=eye, W_aa=2e-3 * np.eye(2),
        W_ac=np.array([[1e-3], [-1e-3]]), W_cc=eye, G_e=np.zeros((1, 0)),
        G_a=np.zeros((2, 0)), G_c=np.zeros((1, 0)), effectors=np.array([-3e-3]),
        actuators=np.zeros(2), gaps=np.zeros(1),
    )  # fmt: skip
    limits = robot.contact_bounds._replace(move_min=np.zeros(0), move_max=np.zeros(0))
    free = np.full(2, np.inf)
    robot = robot._replace(
        system=system, contact_bounds=limits, tensions=np.array([0.0, 1.0]),
        bounds=robot.bounds._replace(shortening_min=-free, shortening_max=free),
    )  # fmt: skip
    answer = solve(robot)
    assert robot.touching.tolist() == [True] and answer.touching.tolist() == [False]
    assert answer.pivots == 1 and answer.stationarity is Stationarity.STRONG
    assert answer.unknowns[2] == 0.0
    assert answer.unknowns[0] == pytest.approx(3.0, rel=1e-3)
    assert robot.problem().gaps(answer.unknowns)[0] == pytest.approx(3e-3, rel=1e-3)


def test_the_last_step_s_contacts_save_programs(robot_in_contact):
    cold, warm = [], []
    for seed in range(30):
        robot = robot_in_contact(seed)
        first = solve(robot)
        again = solve(robot, last=first.touching)
        assert again.objective <= first.objective + 1e-9 * abs(first.objective)
        cold.append(first.programs)
        warm.append(again.programs)
    assert np.all(np.array(warm) <= np.array(cold))
    assert np.mean(warm) == 1.0 and np.mean(cold) > 1.3


@pytest.mark.parametrize("seed", range(20))
def test_contacts_there_twice_neither_cycle_nor_change_the_motion(
    robot_in_contact, complementarity_residual, seed
):
    once = robot_in_contact(seed, contacts=5)
    twice = once.with_contacts(np.tile(np.arange(5), 2))
    problem = twice.problem()
    answer = solve(twice, problem)
    assert answer.solved and answer.programs < 50
    assert complementarity_residual(problem, answer.unknowns) < ADMISSIBLE
    assert answer.objective <= answer.held_objective
    if not np.array_equal(answer.touching[:5], answer.touching[5:]):
        return
    expected = least_of_one(once.problem(), answer.touching[:5], 9)
    if expected is not None:
        motion = np.concatenate([problem.gaps(answer.unknowns)[:5], problem.A @ answer.unknowns])
        of_one = np.concatenate([once.problem().gaps(expected), once.problem().A @ expected])
        np.testing.assert_allclose(motion, of_one, atol=3e-5)


def test_contacts_on_a_rigid_face_share_the_load(robot_in_contact, complementarity_residual):
    """Six contacts whose compliance has rank three."""
    robot = robot_in_contact(1, contacts=3)
    mix = np.random.default_rng(0).dirichlet(np.ones(3), 6)
    system = robot.system
    system = system._replace(
        W_ec=system.W_ec @ mix.T, W_ac=system.W_ac @ mix.T, W_cc=mix @ system.W_cc @ mix.T,
        G_c=mix @ system.G_c, gaps=mix @ (system.gaps - 5e-3),
    )  # fmt: skip
    limits = robot.contact_bounds._replace(force_max=np.full(6, np.inf))
    robot = robot._replace(system=system, contact_bounds=limits)
    path = system.W_aa @ robot.tensions + system.W_ac @ robot.held[9:]
    robot = robot._replace(
        bounds=robot.bounds._replace(shortening_min=path - 3e-3, shortening_max=path + 3e-3)
    )
    problem = robot.problem()
    answer = solve(robot, problem)
    assert answer.solved
    assert complementarity_residual(problem, answer.unknowns) < 1e-8
    assert answer.unknowns[9:].max() < 100.0


@pytest.mark.parametrize("field", ["g", "P", "C", "d", "upper", "force_max"])
def test_what_is_no_number_is_held_out(robot_in_contact, field):
    robot = robot_in_contact(0)
    problem = robot.problem()
    broken = getattr(problem, field).copy()
    broken.flat[0] = np.nan
    answer = solve(robot, problem._replace(**{field: broken}))
    assert not answer.solved and answer.stationarity is Stationarity.HELD
    np.testing.assert_array_equal(answer.unknowns, robot.held)


@pytest.mark.parametrize("most", [0, 1, 2])
@pytest.mark.parametrize("seed", range(8))
def test_a_budget_that_ends_leaves_an_admissible_answer(
    robot_in_contact, complementarity_residual, seed, most
):
    robot = robot_in_contact(seed)
    problem = robot.problem()
    answer = solve(robot, problem, most_programs=most)
    assert answer.programs <= most and answer.solved == (most > 0)
    assert complementarity_residual(problem, answer.unknowns) < ADMISSIBLE
    assert answer.objective <= answer.held_objective


def test_time_that_is_over_is_asked_for_before_each_program(robot_in_contact):
    robot = next(r for r in map(robot_in_contact, range(50)) if solve(r).programs > 2)
    asked = []

    def expired():
        asked.append(True)
        return len(asked) > 1

    answer = solve(robot, expired=expired)
    assert answer.solved and answer.programs == 1
    assert answer.stationarity is Stationarity.BUDGET
    assert not solve(robot, expired=lambda: True).solved


def test_the_same_problem_has_the_same_bits(robot_in_contact):
    robot = robot_in_contact(3)
    first, second = solve(robot), solve(robot)
    np.testing.assert_array_equal(first.unknowns, second.unknowns)


@pytest.mark.parametrize("seed", range(10))
def test_commanded_actuators_are_optimised_around(
    robot_in_contact, complementarity_residual, seed
):
    """One tension and one length are given; the others do no better than when all are free."""
    robot = robot_in_contact(seed)
    bounds = robot.bounds._replace(
        tension_min=robot.bounds.tension_min.copy(), tension_max=robot.bounds.tension_max.copy(),
        shortening_min=robot.bounds.shortening_min.copy(),
        shortening_max=robot.bounds.shortening_max.copy(),
    )  # fmt: skip
    bounds.tension_min[0] = bounds.tension_max[0] = robot.tensions[0]
    wanted = 0.5 * (bounds.shortening_min + bounds.shortening_max)[1]
    bounds.shortening_min[1] = bounds.shortening_max[1] = wanted
    commanded = robot._replace(bounds=bounds)
    problem = commanded.problem()
    answer = solve(commanded, problem)
    assert answer.solved and answer.objective < answer.held_objective
    assert answer.unknowns[0] == robot.tensions[0]
    assert (problem.A @ answer.unknowns)[1] == pytest.approx(wanted, abs=1e-13)
    assert complementarity_residual(problem, answer.unknowns) < ADMISSIBLE
    assert answer.objective >= least_of_one(robot.problem(), answer.touching, 9) @ np.zeros(19) - 1


@pytest.mark.parametrize("energy_weight", [1e-6, 1e-3])
def test_eight_cables_in_three_directions_move_smoothly(robot_in_contact, energy_weight):
    """Along a path of targets the tensions move as smoothly as the path."""
    robot = robot_in_contact(2, contacts=2)
    jumps = []
    for steps in (20, 80):
        tensions, last = [], None
        for share in np.linspace(0.0, 1.0, steps + 1):
            effectors = robot.system.effectors * share
            moved = robot._replace(system=robot.system._replace(effectors=effectors))
            answer = solve(moved, moved.problem(energy_weight), last=last)
            assert answer.solved
            last = answer.touching
            tensions.append(answer.unknowns[:8])
        jumps.append(np.abs(np.diff(tensions, axis=0)).max())
    assert jumps[1] < 0.3 * jumps[0]


def test_one_cable_laid_twice_pulls_half_as_much_each(robot_in_contact):
    robot = robot_in_contact(4, contacts=3, actuators=4)
    of = np.array([0, 1, 2, 3, 0])
    system = robot.system._replace(
        W_ea=robot.system.W_ea[:, of], W_aa=robot.system.W_aa[np.ix_(of, of)],
        W_ac=robot.system.W_ac[of], G_a=robot.system.G_a[of], actuators=np.zeros(5),
    )  # fmt: skip
    bounds = type(robot.bounds)(*(bound[of] for bound in robot.bounds))
    shared = robot.tensions[of] * np.array([0.5, 1, 1, 1, 0.5])
    answer = solve(robot._replace(system=system, bounds=bounds, tensions=shared))
    assert answer.solved
    assert answer.unknowns[0] == pytest.approx(answer.unknowns[4], rel=1e-5, abs=1e-6)
