"""Facts of condensed systems: named groups, and only those contacts that are expected to press."""

import math

import contact_growth
import numpy as np
import pytest
from contact_growth import rubbing_scene
from specimens import column_mesh

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Simulation
from softrobot_twin.simulation.step import linearized
from softrobot_twin.simulation.step.contact_solvers import ContactSolvers
from softrobot_twin.simulation.step.linearized import Linearized
from softrobot_twin.simulation.step.time_budget import StageClock
from softrobot_twin.solvers.contact_gauss_seidel import ContactGaussSeidel
from softrobot_twin.solvers.factorization import NodeRows
from softrobot_twin.study.accuracy_study import write_mesh

STEP, ROUND = 0.01, 40
STEPS = 30
TOLERANCE = 1e-8  # m


@pytest.fixture
def rubbing(tmp_path):
    """A soft block over a stand, under a press that is guided: 15 by 15 nodes below it."""
    write_mesh(tmp_path / "block.vtk", column_mesh((0.06, 0.06, 0.02), (14, 14, 1)))
    return rubbing_scene(tmp_path / "block.vtk", 12)


def rub(simulation, first, last):
    """Press down and rub around; the results of these steps."""
    results = []
    for step in range(first, last):
        angle = 2.0 * math.pi * step / ROUND
        depth = 0.0003 * min(1.0, step / 10.0) * (1.0 - 0.5 * math.sin(angle))
        place = [0.002 * (math.cos(angle) - 1.0), 0.002 * math.sin(angle), -depth]
        simulation.model.guides.aim("press", place)
        results.append(simulation.step(Hold(STEP)))
    return results


@pytest.fixture
def counted(monkeypatch):
    """How often contacts were left out, and how often some were taken in again."""
    counts = {"left out": 0, "taken": 0}
    condense, take = Linearized.__init__, Linearized.take

    def counting_condense(self, *given, **named):
        condense(self, *given, **named)
        counts["left out"] += not self.is_whole

    def counting_take(self, contacts):
        counts["taken"] += 1
        take(self, contacts)

    monkeypatch.setattr(Linearized, "__init__", counting_condense)
    monkeypatch.setattr(Linearized, "take", counting_take)
    return counts


@pytest.fixture
def condensed_whole(monkeypatch):
    """Gives a system with all its rows condensed, and the first row of each contact."""
    condense, made = Linearized.__init__, {}

    def remembering(self, *given, **named):
        made[self] = given
        condense(self, *given, **named)

    def whole(linear):
        factorization, stack, forces, _, row_starts, *_ = made[linear]
        return Linearized(factorization, stack, forces), row_starts

    monkeypatch.setattr(Linearized, "__init__", remembering)
    return whole


def test_an_open_contact_that_closes_in_the_step_is_found(rubbing, counted, monkeypatch):
    # Nothing is expected beyond what pressed: all that closes must be found by its gap.
    monkeypatch.setattr(linearized, "CLOSE", 0.0)
    simulation = Simulation(rubbing)
    for step in range(STEPS):
        (result,) = rub(simulation, step, step + 1)
        assert result.status.is_success and result.report.contact_residual <= TOLERANCE
        contacts = simulation.model.contacts
        linear_gaps = contacts.gaps(simulation.state.positions)
        assert linear_gaps.min(initial=0.0) > -1e-6
    assert counted["left out"] > 0 and counted["taken"] > 0


def test_the_answer_without_open_contacts_solves_the_problem_of_all(rubbing, counted, monkeypatch):
    simulation, whole = Simulation(rubbing), Simulation(rubbing)
    solve, problems = ContactSolvers.solve, []

    def seen(self, problem, *given):
        problems.append(problem)
        return solve(self, problem, *given)

    monkeypatch.setattr(ContactSolvers, "solve", seen)
    judge = ContactGaussSeidel(TOLERANCE, 0)
    for step in range(STEPS):
        whole.restore(simulation.state)
        rub(simulation, step, step + 1)
        with monkeypatch.context() as everything:
            everything.setattr(linearized, "worth_leaving_out", lambda *_: False)
            rub(whole, step, step + 1)
        multipliers = simulation.newton.balance.multipliers
        judged = judge.solve(problems[-1].with_matrix(), multipliers)
        assert judged.gap_residual <= TOLERANCE
        assert judged.force_residual <= 1.1e-6 * multipliers.max()
    assert counted["left out"] > STEPS // 3 and counted["taken"] > 0


def test_gaps_of_omitted_contacts_are_those_of_the_whole_linearization(
    rubbing, condensed_whole, monkeypatch
):
    simulation = Simulation(rubbing)
    rub(simulation, 0, STEPS)
    seen = []
    gaps = Linearized.open_gaps

    def comparing(self, multipliers):
        whole, row_starts = condensed_whole(self)
        all_multipliers = np.zeros(len(whole.violation))
        all_multipliers[self.rows] = multipliers
        delta = whole.W @ all_multipliers + whole.violation
        self.take(np.zeros(len(row_starts) - 1, bool))
        found = gaps(self, multipliers)
        normals = delta[whole.groups.contacts.start + row_starts[:-1]]
        opened = np.setdiff1d(np.arange(len(normals)), self.chosen)
        np.testing.assert_allclose(found[opened], normals[opened], rtol=0, atol=1e-12)
        assert np.isinf(found[self.chosen]).all()
        seen.append(len(opened))
        return found

    monkeypatch.setattr(Linearized, "open_gaps", comparing)
    rub(simulation, STEPS, STEPS + 5)
    assert sum(seen) > 0


def test_forces_are_solved_to_a_millionth_of_the_largest(rubbing):
    simulation = Simulation(rubbing)
    for result in rub(simulation, 0, STEPS):
        forces = result.contacts.forces
        largest = np.linalg.norm(forces, axis=1).max(initial=0.0)
        assert result.report.contact_force_residual <= 1.01e-6 * max(largest, 1e-12)


def test_the_same_steps_give_the_same_bits(rubbing):
    first, again = Simulation(rubbing), Simulation(rubbing)
    rub(first, 0, STEPS)
    rub(again, 0, STEPS)
    np.testing.assert_array_equal(first.state.positions, again.state.positions)
    first.reset()
    rub(first, 0, STEPS)
    np.testing.assert_array_equal(first.state.positions, again.state.positions)


def test_a_restored_state_continues_as_before(rubbing):
    simulation = Simulation(rubbing)
    rub(simulation, 0, STEPS)
    state = simulation.state
    rub(simulation, STEPS, STEPS + 2)
    gone_on = simulation.state.positions
    simulation.restore(state)
    rub(simulation, STEPS, STEPS + 2)
    np.testing.assert_allclose(simulation.state.positions, gone_on, rtol=0, atol=1e-8)


@pytest.fixture
def pulled(tmp_path, monkeypatch):
    """The same with a cable through the block, and a point that is watched."""

    def with_cable(scene, file):
        return scene_from_mapping({
            **scene,
            "cables": [{"name": "cable", "pull_point": [0.02, 0.0, 0.03],
                        "points": [[0.02, 0.0, -0.004], [-0.02, 0.0, -0.016]],
                        "tension": [0.0, 20.0]}],
            "effectors": [{"name": "tip", "points": [[0.0, 0.02, -0.016]],
                           "directions": ["x", "y", "z"]}],
        }, file)  # fmt: skip

    monkeypatch.setattr(contact_growth, "scene_from_mapping", with_cable)
    write_mesh(tmp_path / "block.vtk", column_mesh((0.06, 0.06, 0.02), (14, 14, 1)))
    return rubbing_scene(tmp_path / "block.vtk", 12)


@pytest.mark.sampled
@pytest.mark.parametrize("tension", [0.5, 2.0])
def test_the_path_of_a_pulled_cable_is_that_of_the_whole_linearization(
    pulled, condensed_whole, monkeypatch, tension
):
    simulation = Simulation(pulled)
    rub(simulation, 0, STEPS)
    seen = []
    displacements = Linearized.actuator_displacements

    def comparing(self, efforts, contact):
        whole, row_starts = condensed_whole(self)
        assert whole.groups.contacts.start == 4  # the cable's row, and three of the effector
        delta = whole.W @ np.concatenate([efforts, np.zeros(3), contact]) + whole.violation
        self.take(np.zeros(len(row_starts) - 1, bool))
        found = displacements(self, efforts, contact)
        np.testing.assert_allclose(found, delta[:1], rtol=0, atol=1e-12)
        seen.append(found)
        return found

    monkeypatch.setattr(Linearized, "actuator_displacements", comparing)
    result = simulation.step(CommandEfforts(np.array([tension]), STEP))
    assert seen and result.status.is_success
    np.testing.assert_allclose(result.efforts, tension, rtol=1e-12)
    assert result.report.contact_residual <= TOLERANCE


def linearized_now(simulation):
    """The linearization at a simulation's state."""
    state = simulation.state
    clock = StageClock()
    return simulation.newton.linearize(state.positions.copy(), state.efforts, clock)


def of_stacked_rows(simulation):
    """W = H A⁻¹ Hᵀ and δ_free of all stacked rows, by one solve for each row."""
    model, forces = simulation.model, simulation.newton.balance.forces
    rows, solve = model.rows, model.factorization.solve
    H = NodeRows(rows.row_index, rows.node_index, rows.blocks, rows.row_count)
    columns = H.transposed(len(forces))
    W = columns.T @ solve(columns)
    return W, rows.values + columns.T @ solve(forces).ravel()


def test_without_contact_its_groups_are_actuators_and_effectors(diamond):
    simulation = diamond()
    simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.005, 1.0))
    linear = linearized_now(simulation)
    W, free = of_stacked_rows(simulation)
    assert linear.contact_row_count == 0 and linear.is_whole
    assert linear.groups == (slice(0, 4), slice(4, 7), slice(7, 7))
    np.testing.assert_allclose(linear.W_aa, W[:4, :4], rtol=0, atol=1e-12 * W.max())
    np.testing.assert_allclose(linear.W_ea, W[4:, :4], rtol=0, atol=1e-12 * W.max())
    np.testing.assert_allclose(linear.actuators, free[:4], rtol=0, atol=1e-12)
    np.testing.assert_allclose(linear.effectors, free[4:], rtol=0, atol=1e-12)
    now = simulation.effector_positions().ravel()
    np.testing.assert_allclose(linear.effectors_now, now, rtol=0, atol=1e-15)
    assert linear.move_count == 0


def test_values_of_the_state_are_constant_during_the_step(diamond):
    simulation = diamond()
    linear = linearized_now(simulation)
    before = linear.effectors_now.copy()
    simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.005, 1.0))
    np.testing.assert_array_equal(linear.effectors_now, before)


def test_contacts_are_a_group_of_rows_below_the_others(pulled, monkeypatch):
    monkeypatch.setattr(linearized, "worth_leaving_out", lambda *_: False)
    simulation = Simulation(pulled)
    rub(simulation, 0, STEPS)
    linear = linearized_now(simulation)
    W, free = of_stacked_rows(simulation)
    contacts = linear.groups.contacts
    assert linear.groups[:2] == (slice(0, 1), slice(1, 4)) and contacts.start == 4
    assert contacts.stop - contacts.start == linear.contact_row_count > 0
    np.testing.assert_allclose(linear.W, W, rtol=0, atol=1e-10 * W.max())
    np.testing.assert_allclose(linear.violation, free, rtol=0, atol=1e-10)
    compliance, violation = linear.of_actuators_and_contacts(np.empty(0))
    kept = np.r_[0, contacts.start : contacts.stop]
    np.testing.assert_array_equal(compliance.W, linear.W[np.ix_(kept, kept)])
    np.testing.assert_array_equal(violation, linear.violation[kept])
