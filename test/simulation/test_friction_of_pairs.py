"""Friction belongs to a pair: beside a pair that rubs, contacts without friction keep one row."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Simulation, Status
from softrobot_twin.simulation.step import direct_actuation
from test.scene_changes import repeat_step, solved

G, EDGE, MASS, FRICTION = 9.81, 0.04, 0.03, 0.5
STEP = 0.002


def box(name, position, **more):
    return {"name": name, "mass": MASS, "position": position, "box": {"size": [EDGE] * 3}, **more}


def on_slope(scene_of, angle, bodies, pairs) -> Simulation:
    """Boxes on a level plane in tilted gravity."""
    return scene_of(
        gravity=[G * np.sin(angle), 0.0, -G * np.cos(angle)], integration="dynamic",
        obstacles=[{"name": "slope", "plane": {}}], rigid_bodies=bodies,
        contact={"between": [{"pair": pair, "friction": friction} for *pair, friction in pairs]},
    )  # fmt: skip


def ways(simulation, steps):
    """How far each box went down the slope in each step, and the last result."""
    start, gone = simulation.state.positions[:, 0].copy(), []
    places = [body.first_node for body in simulation.model.rigid]
    for _ in range(steps):
        result = solved(simulation, Hold(STEP))
        gone.append((result.state.positions[:, 0] - start)[places])
    return np.array(gone).T, result


def slid(pull, steps):
    """Way by an acceleration: backward Euler goes ½ a t (t + h)."""
    time = STEP * np.arange(1, steps + 1)
    return 0.5 * pull * time * (time + STEP)


def side_by_side(scene_of, angle):
    bodies = [box("rough", [0, 0, EDGE / 2]), box("smooth", [0, 0.1, EDGE / 2])]
    return on_slope(
        scene_of, angle, bodies, [("rough", "slope", FRICTION), ("smooth", "slope", 0.0)]
    )


def test_only_contacts_of_the_pair_that_rubs_have_three_rows(scene_of):
    simulation = side_by_side(scene_of, np.arctan(0.9 * FRICTION))
    result = simulation.step(Hold(STEP))
    contacts = simulation.model.contacts
    assert contacts.pair_names == (("rough", "slope"), ("smooth", "slope"))
    pair = contacts.pair[: contacts.count]
    assert np.count_nonzero(pair == 0) == np.count_nonzero(pair == 1) == 4
    np.testing.assert_array_equal(np.diff(contacts.row_starts), np.where(pair == 0, 3, 1))
    assert contacts.row_count == len(simulation.newton.balance.multipliers) == 16
    # Forces and pairs of a report agree, whatever the order of rows.
    weight = MASS * G * np.cos(np.arctan(0.9 * FRICTION))
    pairs = result.contacts.of_pairs()
    assert pairs.names == contacts.pair_names
    np.testing.assert_allclose(pairs.resultants[:, 2], weight, rtol=1e-5)
    np.testing.assert_allclose(pairs.resultants[1, :2], 0.0, atol=1e-12)


@pytest.mark.parametrize("share", [0.98, 1.02])
def test_beside_a_box_that_rubs_a_smooth_one_slides_freely(scene_of, share):
    angle = np.arctan(share * FRICTION)
    (rough, smooth), _ = ways(side_by_side(scene_of, angle), 250)
    np.testing.assert_allclose(smooth, slid(G * np.sin(angle), 250), atol=1e-7)
    pull = max(0.0, G * (np.sin(angle) - FRICTION * np.cos(angle)))
    np.testing.assert_allclose(rough, slid(pull, 250), atol=1e-7)


def test_a_smooth_box_slides_over_one_that_sticks_and_bears_it(scene_of):
    angle = np.arctan(0.9 * FRICTION)
    bodies = [box("upper", [0, 0, 1.5 * EDGE]), box("lower", [0, 0, EDGE / 2])]
    simulation = on_slope(
        scene_of, angle, bodies, [("lower", "slope", FRICTION), ("upper", "lower", 0.0)]
    )
    # Its centre stays above the lower box.
    (upper, lower), result = ways(simulation, 35)
    np.testing.assert_allclose(upper, slid(G * np.sin(angle), 35), atol=1e-7)
    assert upper[-1] < EDGE / 2 and np.abs(lower).max() < 1e-8
    names, forces, _ = result.contacts.of_pairs()
    on_lower = forces[names.index(("lower", "slope"))]
    np.testing.assert_allclose(
        on_lower, MASS * G * np.array([-np.sin(angle), 0.0, 2.0 * np.cos(angle)]), atol=1e-5
    )


def in_a_corner(scene_of, soft_block) -> Simulation:
    """A soft block that slides over a smooth floor into a rough wall, and along it."""
    return scene_of(
        gravity=[4.0, 1.5, -9.0], integration="dynamic",
        body=soft_block("block", (0.04, 0.04, 0.02), (4, 4, 2), [-0.0005, 0, 0.01]),
        obstacles=[{"name": "wall", "plane": {}, "rotation": [0, -np.pi / 2, 0],
                    "position": [0.02, 0, 0]},
                   {"name": "floor", "plane": {}}],
        contact={"between": [{"pair": ["block", "wall"], "friction": 0.2},
                             {"pair": ["block", "floor"]}]},
    )  # fmt: skip


def test_motion_and_forces_are_those_of_three_rows_with_a_coefficient_of_zero(
    scene_of, soft_block, monkeypatch
):
    found = in_a_corner(scene_of, soft_block)
    wanted = in_a_corner(scene_of, soft_block)
    # Three rows for every contact of the scene.
    wanted.model.contacts.rows_of_pair[:] = 3
    rows = []
    for _ in range(60):
        first = found.step(Hold(STEP))
        with monkeypatch.context() as patched:
            patched.setattr(direct_actuation, "with_frictionless_contacts", lambda problem: problem)
            second = wanted.step(Hold(STEP))
        assert first.status is second.status is Status.OK
        rows.append((found.model.contacts.row_count, wanted.model.contacts.row_count))
        np.testing.assert_allclose(first.state.positions, second.state.positions, atol=2e-8)
    forces = [result.contacts.of_pairs().resultants for result in (first, second)]
    np.testing.assert_allclose(forces[0], forces[1], atol=1e-4 * np.abs(forces[1]).max())
    assert np.all(np.abs(forces[0])[0, [0, 1]] > 1e-2) and forces[0][1, 2] > 0.1
    assert all(1 < few < 0.7 * many for few, many in rows[-20:])


def test_rows_of_both_kinds_are_those_of_finite_differences(scene_of, soft_block):
    simulation = in_a_corner(scene_of, soft_block)
    repeat_step(simulation, Hold(STEP), 30)
    model, q, step = simulation.model, simulation.state.positions, 1e-7
    rows = model.rows
    model.contacts.begin_step(q, np.empty((0, 3)), STEP)
    rows.detect(q)
    rows.evaluate(q)
    assert set(np.diff(model.contacts.row_starts)) == {1, 3}
    H = np.zeros((rows.row_count, 3 * len(q)))
    nodes = np.flatnonzero(model.nodes.free_index >= 0)
    for row, node, block in zip(rows.row_index, rows.node_index, rows.blocks, strict=True):
        H[row, 3 * nodes[node] : 3 * nodes[node] + 3] += block
    numeric = np.empty_like(H)
    for i in range(q.size):
        sides = []
        for sign in (1.0, -1.0):
            moved = q.copy()
            moved.flat[i] += sign * step
            rows.evaluate(moved)
            sides.append(rows.values.copy())
        numeric[:, i] = (sides[0] - sides[1]) / (2.0 * step)
    np.testing.assert_allclose(H, numeric, atol=1e-7)
