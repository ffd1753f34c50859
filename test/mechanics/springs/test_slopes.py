"""Forces and stiffness of springs, whatever their ends are fixed to."""

import numpy as np
import pytest

from test.builder import each_of

SOFT, SOFT_FREE, UNKNOWNS = 8, 7, 11
POINTS = np.array([[0.05, -0.1, 0.2], [0.0, 0.0, 0.0], [-0.2, 0.1, 0.1]])
KINDS = ["soft to soft", "mass to mass", "soft to world", "soft to rigid", "rigid to rigid",
         "rigid to guided", "rigid to world", "some of each"]  # fmt: skip


kind = each_of(KINDS)


@pytest.fixture(params=["stretched", "pressed"])
def rest_length(request):
    """Distances are about two metres."""
    return 0.3 if request.param == "stretched" else 5.0


def test_forces_are_minus_the_energys_slope(world, kind, rest_length):
    first, second, offsets = world.ends(kind)
    stiffness = np.linspace(50.0, 80.0, first.point_count)
    term, _ = world.springs(first, second, stiffness, rest_length, offsets=offsets)
    x = world.shaken()
    forces = world.forces(term, x)
    slope = world.slopes(x, term.energy).reshape(-1, 3)
    assert np.abs(forces).max() > 1.0
    np.testing.assert_allclose(forces, -slope, atol=1e-6 * np.abs(forces).max())


def test_stiffness_is_the_symmetric_part_of_the_forces_slope(world, kind, rest_length):
    first, second, offsets = world.ends(kind)
    term, matrix = world.springs(first, second, 60.0, rest_length, 3.0, offsets=offsets)
    world.begin(term, 0.1)
    x = world.shaken()
    slope = -world.slopes(x, lambda y: world.forces(term, y))
    K = world.stiffness(term, matrix, x)
    np.testing.assert_allclose(K, 0.5 * (slope + slope.T), atol=1e-6 * np.abs(K).max())
    # The omitted part couples a rotation with itself only, and is half of its torque.
    rest = (slope - slope.T).reshape(UNKNOWNS, 3, UNKNOWNS, 3)
    rest[world.frames.rotations, :, world.frames.rotations] = 0.0
    np.testing.assert_allclose(rest, 0.0, atol=1e-6 * np.abs(K).max())


def test_so_it_is_where_rates_are_taken_from_a_reference(world, kind):
    first, second, offsets = world.ends(kind)
    term, matrix = world.springs(first, second, 60.0, 1.0, 3.0, offsets=offsets)
    reference = world.moved(0.02 * np.random.default_rng(8).standard_normal((UNKNOWNS, 3)))
    term.begin_rates(world.positions, reference, np.zeros((UNKNOWNS, 3)), 0.05)
    x = world.shaken()
    slope = -world.slopes(x, lambda y: world.forces(term, y))
    K = world.stiffness(term, matrix, x)
    np.testing.assert_allclose(K, 0.5 * (slope + slope.T), atol=1e-6 * np.abs(K).max())


def test_a_spring_that_turns_has_no_rate_of_lengthening(world):
    """Its ends move on straight lines to the reference: there it would be longer."""
    term, _ = world.springs(world.nodes(1), world.nodes(2), 0.0, 1.0, 3.0)
    x = world.positions
    across = np.cross(x[2] - x[1], [0.3, -0.2, 0.5])
    reference = x.copy()
    reference[2] += 0.1 * across
    term.begin_rates(x, reference, np.zeros((UNKNOWNS, 3)), 0.05)
    assert np.abs(world.forces(term, x)).max() < 1e-12


def test_the_projected_stiffness_is_never_negative(world, kind, rest_length):
    first, second, offsets = world.ends(kind)
    term, matrix = world.springs(first, second, 60.0, rest_length, offsets=offsets)
    K = world.stiffness(term, matrix, world.shaken(), projected=True)
    values = np.linalg.eigvalsh(K)
    assert values.min() > -1e-13 * values.max()
    assert values.max() > 10.0


def test_a_pressed_spring_is_indefinite_unless_projected(world):
    term, matrix = world.springs(world.nodes(1), world.nodes(2), 60.0, 5.0)
    assert np.linalg.eigvalsh(world.stiffness(term, matrix, world.positions)).min() < -1.0


def test_springs_between_bodies_add_neither_force_nor_torque(world):
    for first, second in (
        (world.frames.points(2, POINTS), world.frames.points(0, POINTS[::-1])),
        (world.soft(1, 2, 3, 4, 2, 3, 4, 5, 1, 2, 6, 7), world.frames.points(0, POINTS)),
    ):
        term, _ = world.springs(first, second, 60.0, 0.1, 2.0)
        world.begin(term, 0.1)
        x = world.shaken()
        forces = world.forces(term, x)
        soft, (t, w) = forces[:SOFT_FREE], (world.frames.translations, world.frames.rotations)
        total = soft.sum(axis=0) + forces[t].sum(axis=0)
        torque = np.cross(x[1:SOFT], soft).sum(axis=0) + forces[w].sum(axis=0)
        torque += np.cross(x[world.frames.origins], forces[t]).sum(axis=0)
        assert np.abs(forces).max() > 1.0
        np.testing.assert_allclose([total, torque], 0.0, atol=1e-11)


def test_a_damper_dissipates_energy_and_gives_no_force_at_rest(world, kind):
    first, second, offsets = world.ends(kind)
    damping = np.linspace(2.0, 3.0, first.point_count)
    term, _ = world.springs(first, second, 0.0, 1.0, damping, offsets=offsets)
    x = world.shaken()
    assert not world.forces(term, x).any()
    h = 0.05
    world.begin(term, h)
    np.testing.assert_array_equal(world.forces(term, world.positions), 0.0)
    # The work on a small further motion is minus the damping of the lengthening so far.
    move = np.random.default_rng(6).standard_normal((UNKNOWNS, 3))
    at, step = world._replace(positions=x), 1e-6
    lengths = term.on_points.lengths
    faster = (lengths(at.moved(move, step)) - lengths(at.moved(move, -step))) / (2 * step)
    rate = (lengths(x) - lengths(world.positions)) / h
    assert np.sum(world.forces(term, x) * move) == pytest.approx(-np.sum(damping * rate * faster))
