"""Beam elements between frames: their derivatives, and states that closed forms give."""

import numpy as np
import pytest

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


def test_elements_without_stiffness_are_refused():
    beams, _, _ = chain(2, tube(0.01, 0.0, 0.3))
    elements = beams.elements._replace(stiffness=np.zeros((2, 6)))
    with pytest.raises(ValueError, match="stiffness of every element must be positive"):
        Beams(elements)
