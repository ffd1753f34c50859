"""Facts of effectors with orientation."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.constraints.effector import EffectorPoints
from softrobot_twin.constraints.effector_orientation import (
    PatchOrientation,
    PosedEffectors,
    frame_arms,
    patch_arms,
    spans_a_plane,
)
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.errors import CommandError
from softrobot_twin.mechanics.kinematics import CarriedPoints
from softrobot_twin.mechanics.rigid_bodies import RigidFrames

from .test_effector import carried

LENGTH = 0.25
PATCH = [(0.02, 0.02, 0.35), (0.15, 0.05, 0.36), (0.1, 0.25, 0.3), (0.05, 0.2, 0.38)]
FLAT_PATCH = [(0.02, 0.02, 0.35), (0.15, 0.02, 0.35), (0.1, 0.25, 0.35)]


def posed(mesh, points=PATCH, axis=None, directions=(0, 1, 2), free_index=None):
    mapping = carried(mesh, points)
    nodes, arms = patch_arms(mapping, mesh.node_positions)
    axis = None if axis is None else np.array(axis) / np.linalg.norm(axis)
    orientation = PatchOrientation(0, nodes, arms, False, axis, 2.0, LENGTH)
    free = np.arange(mesh.node_count) if free_index is None else free_index
    effector = EffectorPoints("tip", mapping, directions, 3.0)
    return PosedEffectors((effector,), (orientation,), free)


@pytest.fixture
def mesh(block):
    return block(cells=(2, 2, 2))


def turned(positions, rotation, drawn_rng):
    """Positions that are turned, moved and deformed."""
    deformed = positions + 0.02 * drawn_rng.standard_normal(positions.shape)
    return deformed @ rotation.as_matrix().T + drawn_rng.standard_normal(3)


def rows_at(term, positions, points=None):
    stack = RowStack([term], points)
    stack.evaluate(positions)
    H = np.zeros((stack.row_count, 3 * (1 + stack.node_index.max())))
    for entry, (row, node) in enumerate(zip(stack.row_index, stack.node_index, strict=True)):
        H[row, 3 * node : 3 * node + 3] += stack.blocks[entry]
    return H.reshape(stack.row_count, -1, 3), stack.values.copy()


@pytest.mark.parametrize("points", [PATCH, FLAT_PATCH], ids=["solid", "flat"])
def test_a_rigid_motion_turns_a_patch_by_its_rotation(mesh, points, drawn_rng):
    term = posed(mesh, points)
    for rotation in Rotation.random(20, random_state=drawn_rng):
        moved = mesh.node_positions @ rotation.as_matrix().T + drawn_rng.standard_normal(3)
        np.testing.assert_allclose(term.rotations(moved)[0], rotation.as_matrix(), atol=1e-12)


def test_the_rotation_of_a_patch_is_the_best_fit(mesh, drawn_rng):
    term, mapping = posed(mesh), carried(mesh, PATCH)
    rest = mapping.positions(mesh.node_positions)
    moved = turned(mesh.node_positions, Rotation.random(random_state=drawn_rng), drawn_rng)
    places = mapping.positions(moved)
    fitted, _ = Rotation.align_vectors(places - places.mean(axis=0), rest - rest.mean(axis=0))
    np.testing.assert_allclose(term.rotations(moved)[0], fitted.as_matrix(), atol=1e-10)


@pytest.mark.parametrize("points", [PATCH, FLAT_PATCH], ids=["solid", "flat"])
@pytest.mark.parametrize("axis", [None, (0.0, 0.0, 1.0), (1.0, -2.0, 0.5)])
@pytest.mark.parametrize("away", [0.0, 1e-9, 0.01, 1.0, 2.5, 3.1])
def test_rows_are_the_derivative_of_the_error(mesh, points, axis, away, drawn_rng):
    term = posed(mesh, points, axis)
    x = turned(mesh.node_positions, Rotation.random(random_state=drawn_rng), drawn_rng)
    about = np.array([1.0, 0, 0]) if axis is None else np.cross(axis, [0.3, 0.9, 0.1])
    off = Rotation.from_rotvec(away * about / np.linalg.norm(about))
    wanted = Rotation.from_matrix(term.rotations(x)[0]) * off
    term.aim(wanted.as_quat()[None], x)
    H, _ = rows_at(term, x)
    move, step = drawn_rng.standard_normal(x.shape), 1e-7
    after, before = rows_at(term, x + step * move)[1], rows_at(term, x - step * move)[1]
    slopes = np.einsum("kni,ni->k", H[:, : len(x)], move[: H.shape[1]])
    np.testing.assert_allclose(
        slopes, (after - before) / (2.0 * step), rtol=2e-5, atol=2e-5 * np.abs(slopes).max()
    )


@pytest.mark.parametrize("axis", [None, (0.0, 1.0, 1.0)])
def test_rows_on_a_rigid_frame_are_derivatives_by_its_unknowns(axis, drawn_rng):
    frames = RigidFrames(0, [True], 0, 2)
    pose = drawn_rng.standard_normal(3), Rotation.random(random_state=drawn_rng).as_matrix()
    rest = frames.rest_nodes([pose])
    nodes, arms = frame_arms(0, rest)
    axis = None if axis is None else np.array(axis) / np.linalg.norm(axis)
    orientation = PatchOrientation(0, nodes, arms, True, axis, 1.0, LENGTH)
    effector = EffectorPoints("tip", frames.points(0, [0.1, 0.2, 0.3]), (), 1.0)
    term = PosedEffectors((effector,), (orientation,), frames.free_index())
    points = CarriedPoints(2, (frames,))
    x = rest.copy()
    frames.advance(x, drawn_rng.standard_normal((2, 3)), 1.0)
    np.testing.assert_allclose(term.rotations(x)[0], frames.pose(x, 0)[1] @ pose[1].T, atol=1e-13)
    term.aim(Rotation.random(random_state=drawn_rng).as_quat()[None], x)
    H, _ = rows_at(term, x, points)
    move, step, values = drawn_rng.standard_normal((2, 3)), 1e-6, []
    for sign in (1.0, -1.0):
        moved = x.copy()
        frames.advance(moved, sign * step * move, 1.0)
        values.append(rows_at(term, moved, points)[1])
    slopes = (values[0] - values[1]) / (2.0 * step)
    np.testing.assert_allclose(np.einsum("kni,ni->k", H, move), slopes, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(H[:, 0], 0.0, atol=1e-14)


def test_the_error_of_an_orientation_is_its_angle_times_the_length(mesh, drawn_rng):
    term, x = posed(mesh), mesh.node_positions
    for angle in (0.0, 1e-6, 1.0, 3.0, np.pi - 1e-6):
        about = drawn_rng.standard_normal(3)
        wanted = Rotation.from_rotvec(angle * about / np.linalg.norm(about))
        rows = term.aim(7.0 * wanted.as_quat()[None], x)
        values = rows_at(term, x)[1][3:]
        assert np.linalg.norm(values - rows) == pytest.approx(LENGTH * angle, abs=1e-12)
        assert term.angles(x)[0] == pytest.approx(angle, abs=1e-12)


@pytest.mark.parametrize("axis", [None, (0.0, 0.0, 1.0)])
def test_a_common_rotation_of_robot_and_target_changes_no_error(mesh, axis, drawn_rng):
    x = turned(mesh.node_positions, Rotation.random(random_state=drawn_rng), drawn_rng)
    wanted, common = Rotation.random(2, random_state=drawn_rng)
    lengths = []
    for turn in (Rotation.identity(), common):
        term = posed(mesh, axis=axis)
        moved = x @ turn.as_matrix().T
        rows = term.aim((turn * wanted).as_quat()[None], moved)
        lengths.append(np.linalg.norm(rows_at(term, moved)[1][3:] - rows))
    assert lengths[0] == pytest.approx(lengths[1], rel=1e-10)


@pytest.mark.parametrize("axis", [None, (0.0, 0.0, 1.0)])
def test_wanted_coordinates_add_up_how_far_the_target_turned(mesh, axis):
    term, x = posed(mesh, axis=axis), mesh.node_positions
    rows = []
    for angle in np.linspace(0.0, 1.5, 31):
        rows.append(term.aim(Rotation.from_rotvec([angle, 0.0, 0.0]).as_quat()[None], x))
    np.testing.assert_allclose(np.linalg.norm(np.diff(rows, axis=0), axis=1), LENGTH * 0.05, rtol=1e-9)
    assert np.linalg.norm(rows[-1] - rows[0]) == pytest.approx(LENGTH * 1.5)
    assert np.linalg.norm(rows_at(term, x)[1][3:] - rows[-1]) == pytest.approx(LENGTH * 1.5)


def test_no_error_is_left_after_many_turns_with_the_target(mesh):
    term = posed(mesh, axis=(0.0, 0.0, 1.0))
    full = posed(mesh)
    steps = 5000
    step = Rotation.from_rotvec([0.1, 0.2, 0.3])
    turn = Rotation.identity()
    for _ in range(steps):
        turn = step * turn
        term.aim(turn.as_quat()[None], mesh.node_positions)
        full.aim(turn.as_quat()[None], mesh.node_positions)
    x = mesh.node_positions @ turn.as_matrix().T
    for one in (term, full):
        rows = one.aim(turn.as_quat()[None], x)
        np.testing.assert_allclose(rows_at(one, x)[1][3:], rows, atol=1e-10)
        assert one.angles(x)[0] < 1e-12


def test_an_axis_that_points_exactly_backwards_is_led_away(mesh):
    term, x = posed(mesh, axis=(0.0, 0.0, 1.0)), mesh.node_positions
    rows = term.aim(np.array([[1.0, 0, 0, 0]]), x)
    H, values = rows_at(term, x)
    assert np.linalg.norm(values[3:] - rows) == pytest.approx(LENGTH * np.pi)
    assert np.isfinite(H).all()
    turn = Rotation.from_rotvec(1e-3 * np.array([1.0, 0.0, 0.0]))
    y = x @ turn.as_matrix().T
    assert term.angles(y)[0] == pytest.approx(np.pi - 1e-3)


def test_an_orientation_without_target_is_free(mesh):
    term = posed(mesh)
    assert np.isnan(term.aim(np.full((1, 4), np.nan), mesh.node_positions)).all()
    assert np.isnan(term.angles(mesh.node_positions)).all()


@pytest.mark.parametrize("quaternion", [[0, 0, 0, 0], [0, 0, np.nan, 1], [1e-9, 0, 0, 0]])
def test_a_quaternion_that_is_no_rotation_is_refused(mesh, quaternion):
    with pytest.raises(CommandError, match="no rotation"):
        posed(mesh).aim(np.array([quaternion], float), mesh.node_positions)


def test_points_on_a_line_span_no_plane():
    assert not spans_a_plane(np.array([[0.0, 0, 0]]))
    assert not spans_a_plane(np.array([[0.0, 0, 0], [1, 1, 1], [2, 2, 2.0]]))
    assert spans_a_plane(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0.0]]))


def test_fixed_nodes_of_a_patch_carry_no_entries(mesh):
    free = np.full(mesh.node_count, -1)
    top = np.flatnonzero(mesh.node_positions[:, 2] > 0.3)
    free[top] = np.arange(len(top))
    term = posed(mesh, free_index=free)
    assert term.entry_nodes.min() >= 0
    H, _ = rows_at(term, mesh.node_positions)
    assert np.isfinite(H).all()
