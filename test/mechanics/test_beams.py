"""Beam elements between frames: their derivatives, and states that closed forms give."""

import numpy as np
import pytest
from scipy.linalg import eigh

from softrobot_twin.mechanics.beam_masses import element_masses
from softrobot_twin.mechanics.beam_sections import rectangle, tube
from softrobot_twin.mechanics.beams import (
    BeamElements,
    Beams,
    curvature_factors,
    element_stiffness,
)
from softrobot_twin.mechanics.rigid_bodies import RigidFrames
from softrobot_twin.mechanics.rotation import rotation_from_vector
from softrobot_twin.mechanics.stencil import stencil_pairs
from softrobot_twin.solvers.superlu import SuperLU

YOUNG, LENGTH = 2.0e6, 0.4


def chain(count, section, poisson=0.3, length=LENGTH, damping=0.0):
    """A straight beam along x whose nodes are all free, and its frames and node positions."""
    step = length / count
    frames = RigidFrames(0, np.ones(count + 1, bool), 0, 2 * (count + 1))
    rest = frames.rest_nodes([(np.array([k * step, 0, 0]), np.eye(3)) for k in range(count + 1)])
    ends = np.column_stack([np.arange(count), np.arange(1, count + 1)])
    elements = BeamElements(
        4 * ends, 2 * ends, np.zeros((count, 2, 3)), np.tile(np.eye(3), (count, 2, 1, 1)),
        np.tile([step, 0, 0, 0, 0, 0], (count, 1)),
        element_stiffness(np.full(count, step), section, YOUNG, poisson), np.full(count, damping),
    )  # fmt: skip
    return Beams(elements), frames, rest


def bound(beams, unknown_count):
    rows, columns = stencil_pairs(beams.stencils())
    matrix = SuperLU(rows, columns, unknown_count)
    beams.bind(matrix.elimination_rank, matrix.slots)
    return matrix


def tangent(beams, matrix, x, projected=False):
    matrix.clear()
    forces = np.zeros((matrix.matrix().shape[0] // 3, 3))
    beams.add(x, forces, matrix.storage, projected)
    return forces, matrix.matrix().toarray()


def moved(frames, x, move, share=1.0):
    after = x.copy()
    frames.advance(after, move, share)
    return after


@pytest.fixture(params=[1, 2, 3])
def bent(request):
    """Two elements in a wild pose, their ends away from the origins of their frames.

    Poses that turn an element by more than it can be are drawn again.
    """
    print("seed", request.param)
    random = np.random.default_rng(request.param)
    frames = RigidFrames(0, np.ones(3, bool), 0, 6)
    ends = np.array([[0, 1], [1, 2]])
    while True:
        poses = [
            (0.3 * random.normal(size=3), rotation_from_vector(0.6 * random.normal(size=3)))
            for _ in range(3)
        ]
        axes = [[rotation_from_vector(0.4 * random.normal(size=3)) for _ in "ab"] for _ in ends]
        beams = Beams(BeamElements(
            4 * ends, 2 * ends, 0.2 * random.normal(size=(2, 2, 3)), np.array(axes),
            0.2 * random.normal(size=(2, 6)), random.uniform(1.0, 3.0, (2, 6)), np.zeros(2),
        ))  # fmt: skip
        x = frames.rest_nodes(poses)
        if beams.add_forces(x, np.zeros((6, 3))) == 0:
            return beams, frames, x, random


def test_forces_are_the_slope_of_the_energy(bent):
    beams, frames, x, _ = bent
    forces = np.zeros((6, 3))
    assert beams.add_forces(x, forces) == 0
    for i, unit in enumerate(np.eye(18)):
        plus, minus = (moved(frames, x, unit.reshape(6, 3), h) for h in (1e-6, -1e-6))
        slope = (beams.energy(plus) - beams.energy(minus)) / 2e-6
        assert -forces.ravel()[i] == pytest.approx(slope, abs=1e-8)


def test_the_tangent_is_the_symmetric_slope_of_the_forces(bent):
    beams, frames, x, _ = bent
    forces, K = tangent(beams, bound(beams, 6), x)
    plain = np.zeros((6, 3))
    beams.add_forces(x, plain)
    assert np.allclose(forces, plain, atol=1e-13)
    slopes = np.zeros((18, 18))
    for i, unit in enumerate(np.eye(18)):
        ends = []
        for h in (1e-6, -1e-6):
            ends.append(np.zeros((6, 3)))
            beams.add_forces(moved(frames, x, unit.reshape(6, 3), h), ends[-1])
        slopes[:, i] = -(ends[0] - ends[1]).ravel() / 2e-6
    assert np.allclose(K, 0.5 * (slopes + slopes.T), atol=1e-7)


def test_the_projected_tangent_is_positive_at_every_pose(bent):
    beams, _, x, _ = bent
    _, K = tangent(beams, bound(beams, 6), x, projected=True)
    assert np.linalg.eigvalsh(K)[0] > -1e-10 * np.abs(K).max()


def test_a_rigid_motion_stores_no_energy_and_gives_no_force(bent):
    beams, frames, _, random = bent
    straight, frames, x = chain(5, tube(0.01, 0.0, 0.3))
    for _ in range(20):
        turn = rotation_from_vector(random.uniform(-np.pi, np.pi, 3))
        shift = random.normal(size=3)
        forces = np.zeros((12, 3))
        straight.add_forces(x @ turn.T + shift, forces)
        stiffest = straight.elements.stiffness.max()
        assert np.abs(forces).max() < 1e-13 * stiffest
        assert straight.energy(x @ turn.T + shift) < 1e-26 * stiffest


def test_forces_turn_with_a_rigid_motion_and_are_in_balance(bent):
    beams, _, x, random = bent
    forces, turned = np.zeros((6, 3)), np.zeros((6, 3))
    beams.add_forces(x, forces)
    turn, shift = rotation_from_vector(random.normal(size=3)), random.normal(size=3)
    beams.add_forces(x @ turn.T + shift, turned)
    assert np.allclose(turned, forces @ turn.T, atol=1e-12)
    assert np.allclose(forces[0::2].sum(axis=0), 0.0, atol=1e-13)
    moments = forces[1::2] + np.cross(x[0::4], forces[0::2])
    assert np.allclose(moments.sum(axis=0), 0.0, atol=1e-12)


@pytest.mark.parametrize("square", [0.0, 1e-9, 0.3, 0.999999, 1.000001, 4.0, 9.0])
def test_factors_of_the_curvature_and_their_slopes(square):
    c, slope, bend = curvature_factors(square)
    if square > 1e-6:
        half = 0.5 * np.sqrt(square)
        assert c == pytest.approx((1.0 - half / np.tan(half)) / square, rel=1e-9)
    h = 1e-3
    at = [curvature_factors(square + k * h) for k in (1, 2, 3, 4)]
    known = [curvature_factors(square + 0.0)[0], *(f[0] for f in at)]
    first = (-25 * known[0] + 48 * known[1] - 36 * known[2] + 16 * known[3] - 3 * known[4]) / 12 / h
    assert slope == pytest.approx(2.0 * first, rel=1e-6)
    second = (35 * known[0] - 104 * known[1] + 114 * known[2] - 56 * known[3] + 11 * known[4]) / 12
    assert bend == pytest.approx(4.0 * second / h**2, rel=2e-3)


@pytest.mark.parametrize("count", [3, 4, 9])
def test_a_beam_bent_to_a_full_circle_needs_end_moments_only(count):
    section = rectangle(0.004, 0.01, 0.3)
    beams, frames, x = chain(count, section)
    radius = LENGTH / (2.0 * np.pi)
    for k, angle in enumerate(np.linspace(0.0, 2.0 * np.pi, count + 1)):
        place = radius * np.array([np.sin(angle), 1.0 - np.cos(angle), 0.0])
        frames.place(x, k, place, rotation_from_vector([0.0, 0.0, angle]))
    forces = np.zeros((2 * count + 2, 3))
    beams.add_forces(x, forces)
    moment = YOUNG * section.inertia_z * 2.0 * np.pi / LENGTH
    expected = np.zeros_like(forces)
    expected[1, 2], expected[-1, 2] = moment, -moment
    assert np.allclose(forces, expected, atol=1e-9 * YOUNG * section.area)


@pytest.mark.parametrize("count", [2, 6])
def test_a_couple_bends_a_rod_of_equal_stiffnesses_to_kirchhoffs_helix(count):
    # GJ = EI for a circle with ν = 0: a constant couple gives constant curvature and torsion.
    section = tube(0.005, 0.0, 0.0)
    beams, frames, x = chain(count, section, poisson=0.0)
    curvature = np.array([3.0, 2.0, 4.0])  # torsion, and two curvatures [1/m]
    fine = 12000 * count
    step = LENGTH / fine
    place, turn = np.zeros(3), np.eye(3)
    half, whole = (rotation_from_vector(share * step * curvature) for share in (0.5, 1.0))
    for k in range(fine + 1):
        if k % (fine // count) == 0:
            frames.place(x, k // (fine // count), place, turn)
        place = place + step * (turn @ half)[:, 0]
        turn = turn @ whole
    forces = np.zeros((2 * count + 2, 3))
    beams.add_forces(x, forces)
    couple = YOUNG * section.inertia_y * curvature
    assert np.allclose(forces[1], couple, rtol=1e-5)
    assert np.allclose(forces[2:-2], 0.0, atol=1e-5 * np.linalg.norm(couple))
    assert np.abs(forces[0::2]).max() < 1e-6 * YOUNG * section.area


def test_one_element_is_timoshenkos_cantilever_for_small_loads():
    section, poisson = rectangle(0.03, 0.02, 0.3), 0.3
    beams, _, x = chain(1, section, poisson, length=0.1)
    _, K = tangent(beams, bound(beams, 4), x)
    shear = YOUNG / (2.0 + 2.0 * poisson)
    for axis, inertia in ((1, section.inertia_z), (2, section.inertia_y)):
        load = np.zeros(6)
        load[axis] = 1.0
        tip = np.linalg.solve(K[6:, 6:], load)
        bending = 0.1**3 / (3.0 * YOUNG * inertia)
        assert tip[axis] == pytest.approx(bending + 0.1 / (shear * section.shear_area_y), rel=1e-12)
    torque = np.linalg.solve(K[6:, 6:], [0, 0, 0, 1.0, 0, 0])
    assert torque[3] == pytest.approx(0.1 / (shear * section.torsion), rel=1e-12)


# --- axial forces ---------------------------------------------------------------------------------

# Slender, of very different stiffnesses in the two planes, and hardly stretched at k² = 10⁴.
RIBBON = rectangle(2.0e-5, 6.0e-5, 0.3)
PLANES = ((1, RIBBON.inertia_z), (2, RIBBON.inertia_y))


def stretched(count, force, section=RIBBON, length=LENGTH):
    """A straight beam along x under an axial force, and its tangent."""
    beams, frames, x = chain(count, section, length=length)
    strain = force / (YOUNG * section.area)
    for k in range(count + 1):
        frames.place(x, k, np.array([(1.0 + strain) * k * length / count, 0, 0]), np.eye(3))
    forces, K = tangent(beams, bound(beams, 2 * count + 2), x)
    return beams, frames, x, forces, K


def lateral(K, count, axis):
    """Stiffness of the places and turns of all nodes in one plane, shape (2 count + 2,) squared."""
    place = 6 * np.arange(count + 1) + axis
    own = np.column_stack([place, place + (4 if axis == 1 else 2)]).ravel()
    return K[np.ix_(own, own)]


@pytest.mark.parametrize("count", [1, 2, 7, 30])
@pytest.mark.parametrize("square", [1e-3, 1.0, 12.5, 1e2, 1e4, 1e6])
@pytest.mark.parametrize("section", [RIBBON, rectangle(0.1 * LENGTH, 0.1 * LENGTH, 0.3)])
def test_a_taut_beam_is_stable_and_stretches_by_its_axial_stiffness(count, square, section):
    force = square * YOUNG * section.inertia_z * count**2 / LENGTH**2
    *_, forces, K = stretched(count, force, section)
    assert forces[-2, 0] == pytest.approx(-force, rel=1e-6)
    assert np.abs(forces[1:-2]).max() < 1e-9 * max(YOUNG * section.area, force)
    assert np.linalg.eigvalsh(K[6:, 6:])[0] > 0.0


@pytest.mark.parametrize("seed", range(3))
def test_no_pose_between_held_ends_stores_less_than_the_straight_one(seed):
    """An element that could fold in tension would let its beam grow."""
    print("seed", seed)
    random, count, strain = np.random.default_rng(seed), 5, 0.01
    beams, frames, x, _, _ = stretched(count, strain * YOUNG * RIBBON.area)
    least = 0.5 * YOUNG * RIBBON.area * LENGTH * strain**2
    assert beams.energy(x) == pytest.approx(least)
    for size in np.repeat([0.01, 0.1, 0.5, 1.0], 25):
        for k in range(count + 1):
            place = np.array([(1.0 + strain) * k * LENGTH / count, 0, 0])
            place += (0 < k < count) * size * random.normal(scale=0.1 * LENGTH, size=3)
            frames.place(x, k, place, rotation_from_vector(size * random.normal(size=3)))
        assert beams.energy(x) > least


# Errors of a load in the middle, where the string has a kink: by the length of an element.
@pytest.mark.parametrize("square, error", [(1e-2, 1e-5), (1.0, 2e-4), (1e2, 7e-3), (1e4, 1.4e-2)])
def test_a_taut_beam_is_as_stiff_to_the_side_as_a_string_with_bending_stiffness(square, error):
    count = 16
    for axis, inertia in PLANES:
        rigidity = YOUNG * inertia
        force = square * rigidity * count**2 / LENGTH**2
        layer, length = np.sqrt(rigidity / force), LENGTH * (1.0 + force / (YOUNG * RIBBON.area))
        K = lateral(stretched(count, force)[-1], count, axis)
        load = np.zeros(2 * count + 2)
        load[-2] = force
        tip = np.linalg.solve(K[2:, 2:], load[2:])[-2]
        assert tip == pytest.approx(length - layer * np.tanh(length / layer), rel=error)
        free = np.delete(np.arange(2 * count + 2), [0, 2 * count])
        load = np.zeros(2 * count + 2)
        load[count] = force
        middle = np.linalg.solve(K[np.ix_(free, free)], load[free])[count - 1]
        exact = 0.25 * length - 0.5 * layer * np.tanh(0.5 * length / layer)
        assert middle == pytest.approx(exact, rel=error)


@pytest.mark.parametrize("square", [1e-2, 1.0, 1e2, 1e4])
def test_a_taut_beam_has_the_frequencies_of_a_string_with_bending_stiffness(square):
    count, mass = 8, 1000.0 * RIBBON.area
    for axis, inertia in PLANES:
        rigidity = YOUNG * inertia
        force = square * rigidity * count**2 / LENGTH**2
        beams, _, _, _, K = stretched(count, force)
        masses = element_masses(
            beams.elements, np.full(count, LENGTH / count), RIBBON, 1000.0, 0.0, np.ones((count, 2))
        )
        M = np.zeros((2 * count + 2, 2 * count + 2))
        for e, own in enumerate(masses.matrices):
            M[2 * e : 2 * e + 4, 2 * e : 2 * e + 4] += own[np.ix_([0, 1, 4, 5], [0, 1, 4, 5])]
        # A turn about z moves the end of the tangent up, one about y moves it down.
        turn = np.tile([1.0, 1.0 if axis == 1 else -1.0], count + 1)
        free = np.delete(np.arange(2 * count + 2), [0, 2 * count])
        squares = eigh(
            lateral(K, count, axis)[np.ix_(free, free)],
            (turn[:, None] * M * turn)[np.ix_(free, free)], eigvals_only=True,
        )  # fmt: skip
        wave = np.arange(1, 4) * np.pi / LENGTH
        exact = np.sqrt((force * wave**2 + rigidity * wave**4) / mass)
        assert np.sqrt(squares[:3]) == pytest.approx(exact, rel=2e-3)


def test_a_load_to_the_side_is_amplified_by_compression_and_euler_s_load_is_met():
    """Of cantilevers with the elements given: P by π² EI/4L², tip by 3 (tan u - u)/u³, u² = PL²/EI."""
    for count, error in ((1, 8e-3), (2, 6e-4), (4, 5e-5)):
        for axis, inertia in PLANES:
            rigidity = YOUNG * inertia
            euler = 0.25 * np.pi**2 * rigidity / LENGTH**2
            for share in (0.2, 0.5, 0.8):
                K = lateral(stretched(count, -share * euler)[-1], count, axis)[2:, 2:]
                load = np.zeros(2 * count)
                load[-2] = 3.0 * rigidity / LENGTH**3
                u = 0.5 * np.pi * np.sqrt(share)
                # The error of Euler's load comes back by the distance from it.
                assert np.linalg.solve(K, load)[-2] == pytest.approx(
                    3.0 * (np.tan(u) - u) / u**3, rel=error * share / (1.0 - share) + 1e-6
                )
            below, above = (
                np.linalg.eigvalsh(lateral(stretched(count, -share * euler)[-1], count, axis)[2:, 2:])
                for share in (1.0 - 1e-6, 1.0 + error)
            )
            assert below[0] > 0.0 > above[0] and above[1] > 0.0


def test_one_element_that_may_only_sway_bows_at_its_own_buckling_load():
    """π² EI/L² of a column clamped at both ends that may sway; the bow of the S gives 10."""
    rigidity = YOUNG * RIBBON.inertia_z
    for load, is_stable in ((9.8, True), (10.1, False)):
        K = stretched(1, -load * rigidity / LENGTH**2)[-1]
        assert (K[7, 7] > 0.0) == is_stable


def test_forces_of_slender_elements_far_from_straight_are_slopes_too(drawn_rng):
    """Stretched and compressed by more than their bending resists, nodes turned and shifted."""
    for strain in (-0.02, 0.0, 0.05):
        section = rectangle(0.002, 0.005, 0.3)
        beams, frames, x, _, _ = stretched(2, strain * YOUNG * section.area, section)
        matrix = bound(beams, 6)
        x = moved(frames, x, drawn_rng.normal(size=(6, 3)) * np.tile([[0.02], [0.3]], (3, 1)))
        beams.begin_step(x, np.empty((0, 3)), 0.01)
        forces, K = tangent(beams, matrix, x)
        size, slopes = np.abs(K).max(), np.zeros((18, 18))
        for i, unit in enumerate(np.eye(18)):
            plus, minus = (moved(frames, x, unit.reshape(6, 3), h) for h in (1e-6, -1e-6))
            slope = (beams.energy(plus) - beams.energy(minus)) / 2e-6
            assert -forces.ravel()[i] == pytest.approx(slope, abs=1e-7 * size)
            ends = np.zeros((2, 6, 3))
            beams.add_forces(plus, ends[0])
            beams.add_forces(minus, ends[1])
            slopes[:, i] = -(ends[0] - ends[1]).ravel() / 2e-6
        assert np.allclose(K, 0.5 * (slopes + slopes.T), atol=1e-7 * size)


def test_the_energy_grows_until_the_ends_of_an_element_point_back_along_its_chord():
    """Else an element of a taut beam could rest reversed."""
    beams, frames, x, _, _ = stretched(1, 1e3 * YOUNG * RIBBON.inertia_z / LENGTH**2)
    for axis in np.eye(3)[1:]:
        energies = []
        for angle in np.linspace(0.0, 0.999 * np.pi, 60):
            frames.place(x, 0, np.zeros(3), rotation_from_vector(angle * axis))
            frames.place(x, 1, np.array([LENGTH, 0, 0]), rotation_from_vector(angle * axis))
            energies.append(beams.energy(x))
        assert (np.diff(energies) > 0.0).all()


def test_an_element_bent_by_half_a_turn_counts_as_folded_and_a_move_stops_before():
    beams, frames, x = chain(2, tube(0.01, 0.0, 0.3))
    move = np.zeros((6, 3))
    move[5, 1] = 3.1
    after = moved(frames, x, move)
    assert beams.add_forces(after, np.zeros((6, 3))) == 1
    share = beams.largest_share(x, after)
    assert 0.5 < share < 1.0
    assert beams.add_forces(moved(frames, x, move, share), np.zeros((6, 3))) == 0


def test_damping_takes_the_work_of_the_strain_rate():
    beams, frames, x = chain(3, tube(0.01, 0.0, 0.3), damping=0.02)
    random = np.random.default_rng(5)
    move = 1e-5 * random.normal(size=(8, 3))
    after = moved(frames, x, move)
    beams.begin_step(x, np.empty((0, 3)), 0.1)
    damped, elastic = np.zeros((8, 3)), np.zeros((8, 3))
    beams.add_forces(after, damped)
    undamped, _, _ = chain(3, tube(0.01, 0.0, 0.3))
    undamped.add_forces(after, elastic)
    # From rest the strain rate is the strain over h: β/h = 0.2 of the elastic force is added.
    assert np.allclose(damped, 1.2 * elastic, rtol=1e-6, atol=1e-9 * np.abs(elastic).max())
    assert beams.energy(after) == undamped.energy(after)
