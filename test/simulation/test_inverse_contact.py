"""Facts of inverse steps in contact: what touches pushes, what pushes touches, nothing crosses."""

import itertools
from ctypes import c_int

import daqp
import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Status
from softrobot_twin.solvers import inverse_solver
from softrobot_twin.solvers.pivoting import solve_by_pivoting
from test.edge_of_touch import check_rest_at_the_edge
from test.scene_changes import repeat_step

AXIS = np.array([0.03, 0.08])
RADIUS = 0.005


@pytest.fixture
def posed(monkeypatch):
    """Every program that the inverse poses, and its answer."""
    programs = []

    def record(problem, *given, **named):
        programs.append((problem, solve_by_pivoting(problem, *given, **named)))
        return programs[-1][1]

    monkeypatch.setattr(inverse_solver, "solve_by_pivoting", record)
    return programs


def least_of_piece(problem, touching):
    """The optimum with given contacts in touch, by an active-set solver; None where empty."""
    first = len(problem.g) - problem.contact_count
    free = np.concatenate([np.arange(first), first + np.flatnonzero(touching)])
    P = problem.P[np.ix_(free, free)]
    scale = 1.0 / np.sqrt(P.diagonal())
    T = scale[:, None] * np.linalg.inv(np.linalg.cholesky(P * np.outer(scale, scale))).T
    q = T.T @ problem.g[free]
    size = np.linalg.norm(q) or 1.0
    rows = np.concatenate([np.eye(len(free)), problem.A[:, free], problem.C[:, free]]) @ (size * T)
    lengths = np.linalg.norm(rows, axis=1)
    lengths[lengths == 0.0] = 1.0
    lower = np.concatenate([problem.lower[free], problem.row_lower, -problem.d])
    upper = np.concatenate([problem.upper[free], problem.row_upper, np.where(touching, -problem.d, np.inf)])
    sense = np.where(lower == upper, 5, 0).astype(c_int)
    w, _, flag, _ = daqp.solve(
        np.eye(len(free)), q / size, rows / lengths[:, None],
        np.minimum(upper / lengths, 1e30), np.maximum(lower / lengths, -1e30), sense,
        primal_tol=1e-11,
    )  # fmt: skip
    if flag != 1:
        return None
    z = np.zeros(len(problem.g))
    z[free] = size * T @ w
    return z


def least_of_all(problem) -> float:
    pieces = itertools.product((False, True), repeat=problem.contact_count)
    found = [least_of_piece(problem, np.array(piece)) for piece in pieces]
    return min(problem.objective(z) for z in found if z is not None)


def surface_gap(simulation, centre=AXIS, radius=RADIUS) -> float:
    """Least distance of points all over the beam's surface from a rod along y [m]."""
    grid = [(i / 12, j / 12) for i in range(13) for j in range(13 - i)]
    weights = np.array([(a, b, 1 - a - b) for a, b in grid])
    corners = simulation.surface_positions()[simulation.surface_triangles]
    points = np.einsum("gk,tki->gti", weights, corners).reshape(-1, 3)
    return float(np.linalg.norm(points[:, [0, 2]] - centre, axis=1).min() - radius)


def circling(simulation, turns, per_turn):
    """Targets on a wide circle, half of it behind the rod."""
    home = simulation.effector_positions()[0]
    for angle in np.linspace(0.0, 2 * np.pi * turns, turns * per_turn, endpoint=False):
        way = [0.012 + 0.012 * np.sin(angle), 0.006 * np.cos(1.9 * angle), -0.004]
        yield (home + way)[None]


def follow(simulation, target, steps=60, time_step=0.05):
    return repeat_step(simulation, FollowTargets(np.atleast_2d(target), time_step), steps)


@pytest.mark.parametrize("height", [0.05, 0.08])
def test_gaps_and_forces_are_complementary_in_every_step_of_a_run(beam, rod, height):
    simulation = beam(lambda m: rod(m, z=height))
    contacts, carried = simulation.model.contacts, 0
    for target in circling(simulation, 3, 40):
        result = simulation.step(FollowTargets(target, 0.05))
        gaps = contacts.gaps(simulation.state.positions)
        assert gaps.min(initial=0.0) > -1e-8
        assert np.all(np.einsum("ci,ci->c", result.contacts.forces, [[-1, 0, 0]]) >= 0.0)
        assert np.abs(result.contacts.gaps).max(initial=0.0) < 1e-8
        assert result.report.contact_residual < 1e-8
        assert surface_gap(simulation, np.array([0.03, height])) > -2e-5
        carried += len(result.contacts.forces)
    assert carried > 10


@pytest.mark.parametrize("height", [0.05, 0.08])
def test_every_answer_is_the_best_of_all_contact_branches(beam, rod, posed, height):
    simulation = beam(lambda m: rod(m, z=height))
    for target in circling(simulation, 2, 25):
        simulation.step(FollowTargets(target, 0.05))
    few = [(p, found) for p, found in posed if 0 < p.contact_count <= 6][::2]
    assert len(few) > 20
    assert any(found.touching.any() for _, found in few)
    for problem, found in few:
        least = least_of_all(problem)
        assert found.solved
        assert found.objective == pytest.approx(least, rel=1e-6, abs=1e-9 * abs(least))


def test_a_target_behind_the_rod_is_approached_to_the_nearest_reachable_point(beam, rod):
    simulation = beam(lambda m: rod(m))
    target = simulation.effector_positions()[0] + [0.03, 0.004, -0.012]
    result = follow(simulation, target, 120)
    assert result.report.contact_count > 0
    assert surface_gap(simulation) == pytest.approx(0.0, abs=2e-5)
    # No small change of the lengths that the hardware admits comes nearer.
    state, limits = simulation.state, simulation.limits
    for change in itertools.product((-2e-4, 0.0, 2e-4), repeat=4):
        shortening = result.displacements + change
        if np.any(shortening < limits.displacement_min) or not any(change):
            continue
        simulation.restore(state)
        for _ in range(4):
            moved = simulation.step(CommandSetpoints(simulation.rest_setpoints - shortening, 1.0))
        distance = np.linalg.norm(moved.effector_positions - target)
        assert distance > result.effector_errors[0] - 1e-6


def test_the_beam_presses_on_the_rod_to_get_further(beam, rod):
    leaning = beam(lambda m: rod(m, z=0.05))
    touching = beam(lambda m: rod(m, z=0.05, force_limit=1e-3))
    target = leaning.effector_positions()[0] + [0.03, 0.0, -0.012]
    leant, touched = follow(leaning, target), follow(touching, target)
    assert np.linalg.norm(leant.contacts.forces) > 0.3
    assert leant.effector_errors[0] < touched.effector_errors[0] - 1e-3


@pytest.mark.parametrize("height", [0.05, 0.08])
def test_a_target_behind_the_rod_is_held_without_drift(beam, rod, height):
    simulation = beam(lambda m: rod(m, z=height))
    target = simulation.effector_positions()[0] + [0.03, 0.01, -0.01]
    result = follow(simulation, target, 100)
    there, lengths, force = result.effector_positions, result.setpoints, result.contacts.forces
    result = follow(simulation, target, 300)
    np.testing.assert_allclose(result.effector_positions, there, atol=1e-8)
    np.testing.assert_allclose(result.setpoints, lengths, atol=1e-8)
    np.testing.assert_allclose(result.contacts.forces, force, atol=1e-5)
    assert result.status in (Status.UNREACHABLE, Status.SATURATED)


def test_contact_can_be_made_and_lost_at_every_step(beam, rod):
    simulation = beam(lambda m: rod(m))
    home = simulation.effector_positions()[0]
    into, out = home + [0.02, 0.0, -0.006], home + [0.004, 0.0, -0.003]
    counts, places = [], {0: [], 1: []}
    for step in range(60):
        result = simulation.step(FollowTargets(np.atleast_2d(out if step % 2 else into), 10.0))
        counts.append(result.report.contact_count)
        assert surface_gap(simulation) > -2e-5
        if step >= 20:
            places[step % 2].append(result.effector_positions[0])
    assert all(count > 0 for count in counts[20::2]) and not any(counts[21::2])
    assert np.ptp(places[0], axis=0).max() < 1e-7
    np.testing.assert_allclose(places[1], np.tile(out, (20, 1)), atol=1e-6)


def test_near_zero_gap_contacts_do_not_chatter(beam, rod):
    check_rest_at_the_edge(beam(lambda m: rod(m)), settling=40, still=1e-8, pressed=1e-5, near=2e-5)


def test_friction_at_given_lengths_stays_in_its_cone(beam, rod):
    simulation = beam(lambda m: rod(m, friction=0.3))
    wound = simulation.rest_setpoints - [0.012, 0.0, 0.0, 0.0]
    result = repeat_step(simulation, CommandSetpoints(wound, 0.05), 40)
    assert len(result.contacts.forces)
    for point, force in zip(result.contacts.positions, result.contacts.forces, strict=True):
        outward = np.array([point[0] - AXIS[0], 0.0, point[2] - AXIS[1]])
        normal = force @ outward / np.linalg.norm(outward)
        assert normal > 0.1
        assert 0.0 < np.linalg.norm(force) ** 2 - normal**2 <= (0.3 * normal) ** 2 * (1 + 1e-3)
