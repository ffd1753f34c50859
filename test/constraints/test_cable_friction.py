"""Facts of friction along cables."""

import numpy as np
import pytest
from scipy.integrate import trapezoid

from softrobot_twin.constraints.cable import CablePath
from softrobot_twin.constraints.cable_friction import CableMaterials, FrictionCables
from softrobot_twin.mechanics.barycentric import BarycentricMapping

MU = 0.1


def zigzag(count=6):
    """Points whose path turns in three dimensions; the last segment is as long as the others."""
    rng = np.random.default_rng(4)
    along = np.column_stack([0.05 * np.arange(count), np.zeros(count), np.zeros(count)])
    return along + 0.02 * rng.standard_normal((count, 3))


def make(points, friction=MU, stiffness=np.inf, presliding=1e-4, pull=(-0.05, 0.01, 0.0)):
    """One cable on nodes of their own; carriers are the nodes themselves."""
    count = len(points)
    mapping = BarycentricMapping(np.arange(count)[:, None], np.ones((count, 1)))
    path = CablePath("c", mapping, np.array(pull, float))
    materials = CableMaterials(np.array([stiffness]), np.array([friction]), np.array([presliding]))
    return FrictionCables((path,), np.arange(count), np.array(points, float), materials)


def solved(term, positions, tension):
    term.tell_efforts(np.array([tension]))
    blocks, values = term.rows_at(positions)
    return values[0]


def go(term, positions, *tensions):
    """Steps over tensions at held points."""
    for tension in tensions:
        solved(term, positions, tension)
        term.recall({"shares": term.shares}, positions, np.array([tension]))


def capstan(term, sign):
    """T_n / T_0 where every point slips."""
    return np.exp(-sign * MU * term.angles.sum())


def test_over_fixed_points_pulling_and_releasing_give_the_capstan_equation():
    x = zigzag()
    term = make(x, stiffness=50.0)
    for tension in (1.0, 2.0, 5.0):
        solved(term, x, tension)
        assert term.tensions[-1] / term.tensions[0] == pytest.approx(capstan(term, 1), rel=1e-12)
        np.testing.assert_allclose(
            term.tensions[1:] / term.tensions[:-1], np.exp(-MU * term.angles[1:]), rtol=1e-12
        )
        term.recall({"shares": term.shares}, x, np.array([tension]))
    solved(term, x, 1.0)
    assert term.tensions[-1] / term.tensions[0] == pytest.approx(capstan(term, -1), rel=1e-12)


def test_released_a_little_the_cable_sticks_and_its_end_keeps_its_tension():
    x = zigzag()
    term = make(x, stiffness=50.0, presliding=1e-9)
    go(term, x, 5.0)
    before = term.tensions.copy()
    solved(term, x, 4.9)
    assert term.tensions[0] == 4.9
    np.testing.assert_allclose(term.tensions[-3:], before[-3:], rtol=1e-4)


def test_without_presliding_left_a_tension_is_the_same_in_steps_of_any_size():
    x = zigzag()
    fine, coarse = make(x, stiffness=50.0), make(x, stiffness=50.0)
    go(fine, x, *np.linspace(0.1, 5.0, 40))
    go(coarse, x, 5.0)
    np.testing.assert_allclose(fine.tensions, coarse.tensions, rtol=1e-12)
    go(fine, x, *np.linspace(4.9, 3.0, 40))
    go(coarse, x, 3.0)
    np.testing.assert_allclose(fine.tensions, coarse.tensions, rtol=5e-3)


def test_a_loop_of_pulling_and_releasing_closes_and_encloses_work():
    x = zigzag()
    term = make(x, stiffness=20.0)
    up, down = np.linspace(1.0, 5.0, 60), np.linspace(5.0, 1.0, 60)
    go(term, x, *up, *down)
    loops = []
    for _ in range(2):
        loop = []
        for tension in (*up, *down):
            loop.append((solved(term, x, tension), tension))
            term.recall({"shares": term.shares}, x, np.array([tension]))
        loops.append(np.array(loop))
    np.testing.assert_allclose(loops[1], loops[0], rtol=1e-9, atol=1e-12)
    work = trapezoid(loops[1][:, 1], loops[1][:, 0])
    assert work > 1e-4


def test_a_straight_path_has_no_friction():
    x = np.column_stack([0.05 * np.arange(4), np.zeros(4), np.zeros(4)])
    term = make(x, stiffness=50.0, pull=(-0.05, 0.0, 0.0))
    solved(term, x, 3.0)
    np.testing.assert_allclose(term.tensions, 3.0, rtol=1e-14)


def test_a_slack_cable_stays_slack():
    x = zigzag()
    term = make(x, stiffness=50.0)
    go(term, x, 5.0, 0.0)
    assert term.tensions.tolist() == [0.0] * len(term.tensions)
    forces = np.zeros((len(x), 3))
    term.held_forces.add_forces(x, forces)
    assert not forces.any()
    assert np.isfinite(term.compliance).all()


@pytest.mark.parametrize("stiffness", [np.inf, 30.0])
def test_the_share_of_friction_grows_over_the_presliding(stiffness):
    """The far end follows the winch by less than the presliding: it neither sticks nor slips."""
    x = zigzag()
    term = make(x, stiffness=stiffness, presliding=5e-3)
    go(term, x, 2.0)
    moved = x.copy()
    moved[-1] += 1e-3 * (x[-2] - x[-1]) / np.linalg.norm(x[-2] - x[-1])
    before = term.shares[-1]
    solved(term, moved, 2.0)
    assert 0.0 < term.shares[-1] - before < 0.25


def states(stiffness):
    """A cable of which some points slip and others stick, and its state."""
    x = zigzag()
    term = make(x, stiffness=stiffness, presliding=2e-3)
    go(term, x, 3.0)
    moved = x + 2e-3 * np.random.default_rng(1).standard_normal(x.shape)
    return term, moved, 2.5


@pytest.mark.parametrize("stiffness", [np.inf, 40.0])
def test_rows_are_how_forces_change_with_the_tension_at_the_winch(stiffness):
    term, x, tension = states(stiffness)
    step = 1e-5
    forces = np.zeros((2, len(x), 3))
    for side, change in enumerate((step, -step)):
        term.tell_efforts(np.array([tension + change]))
        term.held_forces.add_forces(x, forces[side])
    term.tell_efforts(np.array([tension]))
    blocks, values = term.rows_at(x)
    assert 0 < np.count_nonzero(np.abs(term.shares) < 1.0)
    row = np.zeros((len(x), 3))
    np.add.at(row, term.entry_nodes, blocks)
    np.testing.assert_allclose(row, (forces[0] - forces[1]) / (2 * step), atol=1e-6)


@pytest.mark.parametrize("stiffness", [np.inf, 40.0])
def test_the_compliance_is_the_slope_of_the_shortening(stiffness):
    term, x, tension = states(stiffness)
    step = 1e-5
    slope = (solved(term, x, tension + step) - solved(term, x, tension - step)) / (2 * step)
    solved(term, x, tension)
    assert term.compliance[0, 0] == pytest.approx(slope, abs=1e-9)


@pytest.mark.parametrize("stiffness", [np.inf, 40.0])
def test_rows_of_lengths_are_the_derivative_of_the_shortening_at_held_angles(stiffness):
    term, x, tension = states(stiffness)
    solved(term, x, tension)
    row = np.zeros((len(x), 3))
    np.add.at(row, *(term.displacement_entries()[k] for k in (1, 2)))
    step = 1e-7
    # Along the path no angle changes: the last point moves along the last segment.
    along = (x[-1] - x[-2]) / np.linalg.norm(x[-1] - x[-2])
    ahead, behind = x.copy(), x.copy()
    ahead[-1] += step * along
    behind[-1] -= step * along
    slope = (solved(term, ahead, tension) - solved(term, behind, tension)) / (2 * step)
    assert row[-1] @ along == pytest.approx(slope, abs=1e-6)


@pytest.mark.parametrize("stiffness", [np.inf, 40.0])
def test_the_stiffness_of_sticking_is_the_derivative_of_the_pull_along_a_segment(stiffness):
    term, x, tension = states(stiffness)
    solved(term, x, tension)
    rows = term.stick_rows()
    along = (x[-1] - x[-2]) / np.linalg.norm(x[-1] - x[-2])
    h = np.zeros(len(rows.stiffness))
    for row, node, block in zip(rows.row_index, rows.node_index, rows.blocks):
        h[row] += block @ along if node == len(x) - 1 else 0.0
    step, pulls = 1e-7, []
    for change in (step, -step):
        moved, forces = x.copy(), np.zeros((len(x), 3))
        moved[-1] += change * along
        term.held_forces.add_forces(moved, forces)
        pulls.append(forces[-1] @ along)
    assert (rows.stiffness * h) @ h == pytest.approx(-(pulls[0] - pulls[1]) / (2 * step), rel=1e-5)


def test_stick_has_no_negative_stiffness():
    term, x, tension = states(30.0)
    solved(term, x, tension)
    assert (term.stick_rows().stiffness > 0.0).all()


# With the first ones the potential of some states is almost zero, and its parts are not.
@pytest.mark.parametrize("seed", [1343814888, 2951581421, 2261441627, None])
def test_many_points_of_any_angle_are_solved(seed, drawn_rng):
    rng = np.random.default_rng(seed) if seed else drawn_rng
    for _ in range(20):
        x = rng.standard_normal((25, 3)) * 0.1
        term = make(x, friction=rng.uniform(0, 1), stiffness=10 ** rng.uniform(0, 4),
                    presliding=10 ** rng.uniform(-7, -3))  # fmt: skip
        tension = 1.0
        for _ in range(5):
            tension *= rng.uniform(0.3, 2.0)
            y = x + 0.005 * rng.standard_normal(x.shape)
            solved(term, y, tension)
            z, s_0 = term.shares, term.materials.presliding[0]
            missed = s_0 * (z - term.begin_shares) - (term.begin_beyond - term.beyond)
            # Of lengths of metres.
            inside, allowed = np.abs(z[1:]) < 1.0, 1e-9
            assert np.abs(missed[1:][inside]).max(initial=0.0) < allowed
            assert (missed[1:][z[1:] == 1.0] <= allowed).all()
            assert (missed[1:][z[1:] == -1.0] >= -allowed).all()
            term.recall({"shares": z}, y, np.array([tension]))
