"""Scenes with friction along cables."""

import numpy as np
import pytest

from softrobot_twin.constraints.cable_friction import FrictionCables
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, FollowTargets, Simulation, Status

from .building.test_reduced_body import spanning_basis
from .test_reduced_contact import saved_beside
from test.builder import builder
from test.scene_changes import repeat_step, solved

SHARES = "cable_friction_0.shares"


def rubbing(friction=0.3, iterations=60, tolerance=1e-8, **more):
    def change(mapping):
        for cable in mapping["cables"]:
            # A path that turns: its points lie alternately nearer to the axis.
            for index, point in enumerate(cable["points"]):
                share = 0.5 if index % 2 else 1.0
                point[:2] = [0.01 + share * (point[0] - 0.01), 0.01 + share * (point[1] - 0.01)]
            cable.update(friction=friction, shortening=[0.0, 0.05], rate=None, **more)
        mapping["solver"] = {"newton_iterations": iterations, "residual_tolerance": tolerance}

    return change


def term_of(simulation) -> FrictionCables:
    (term,) = (term for term in simulation.terms if isinstance(term, FrictionCables))
    return term


def pull(simulation, *shortenings):
    lengths = simulation.rest_setpoints - np.array(shortenings)
    return simulation.step(CommandSetpoints(lengths, 0.1))


def of_east(simulation):
    term = term_of(simulation)
    own = slice(0, len(term.paths[0].points.nodes))
    return term.tensions[own], term.angles[own]


def test_pulling_and_releasing_a_beam_give_the_capstan_equation(beam):
    simulation = beam(rubbing(0.3))
    for shortening in np.linspace(0.002, 0.01, 5):
        result = pull(simulation, shortening, 0.0, 0.0, 0.0)
        assert result.status is Status.OK
    tensions, angles = of_east(simulation)
    assert angles.sum() > 0.5
    assert tensions[-1] == pytest.approx(tensions[0] * np.exp(-0.3 * angles.sum()), rel=1e-9)
    for shortening in np.linspace(0.009, 0.005, 5):
        result = pull(simulation, shortening, 0.0, 0.0, 0.0)
        assert result.status is Status.OK
    tensions, angles = of_east(simulation)
    assert tensions[-1] == pytest.approx(tensions[0] * np.exp(0.3 * angles.sum()), rel=1e-9)


def test_a_loop_of_pulling_and_releasing_closes(beam):
    simulation = beam(rubbing(0.2))
    ramp = np.concatenate([np.linspace(0.004, 0.01, 7), np.linspace(0.009, 0.003, 7)])
    loops = [np.array([pull(simulation, s, 0, 0, 0).efforts[0] for s in ramp]) for _ in range(3)]
    np.testing.assert_allclose(loops[2], loops[1], rtol=1e-5)
    up, down = loops[1][1], loops[1][11]
    assert down < 0.9 * up


def test_without_friction_the_term_bends_the_beam_as_plain_cables_do(beam):
    plain, tiny = beam(rubbing(0.0)), beam(rubbing(1e-9))
    assert plain.model.actuators.conserves and not tiny.model.actuators.conserves
    a, b = (pull(simulation, 0.008, 0.002, 0.0, 0.0) for simulation in (plain, tiny))
    np.testing.assert_allclose(a.efforts, b.efforts, atol=1e-5)
    np.testing.assert_allclose(a.state.positions, b.state.positions, atol=1e-8)


@pytest.mark.parametrize("stiffness", [None, 500.0])
def test_the_inverse_reaches_a_target_against_friction(beam, stiffness):
    simulation = beam(rubbing(0.3, 10, 1e-3, axial_stiffness=stiffness))
    goal = beam(rubbing(0.0))
    pull(goal, 0.008, 0.004, 0.0, 0.0)
    target = goal.effector_positions()
    result = repeat_step(simulation, FollowTargets(target, 0.1), 40)
    assert result.status.is_success
    assert np.linalg.norm(simulation.effector_positions() - target) < 1e-6
    again = pull(simulation, *result.displacements)
    np.testing.assert_allclose(again.effector_positions, result.effector_positions, atol=1e-5)


def test_back_and_forth_the_inverse_reaches_its_targets(beam):
    simulation = beam(rubbing(0.4, 10, 1e-3), {"effectors.0.directions": ["x", "y"]})
    slipped = []
    for x in (0.005, 0.012, 0.006, -0.003, 0.008):
        target = np.array([[0.01 + x, 0.012, 0.1]])
        result = repeat_step(simulation, FollowTargets(target, 0.1), 20)
        assert result.effector_errors[0] < 1e-5, x
        # What the targets leave open goes on towards the least energy.
        assert result.report.residual < 1e-2 * result.efforts.max(), x
        slipped.append(of_east(simulation)[0][-1] / max(result.efforts[0], 1e-9))
    # The same direction of the target, but other tensions after another history.
    assert max(slipped) > 1.1 * min(slipped)


def test_commanded_tensions_are_those_at_the_winches(beam):
    simulation = beam(rubbing(0.3))
    wanted = np.array([3.0, 1.0, 0.0, 0.0])
    result = solved(simulation, CommandEfforts(wanted, 0.1), 3)
    np.testing.assert_allclose(result.efforts, wanted, atol=1e-9)
    tensions, angles = of_east(simulation)
    assert tensions[-1] == pytest.approx(3.0 * np.exp(-0.3 * angles.sum()), rel=1e-6)


def test_a_cable_with_friction_goes_slack_and_taut_again(beam):
    simulation = beam(rubbing(0.3, axial_stiffness=800.0))
    ramp = [0.0, 0.002, 0.006, 0.003, 0.001, 0.0, 0.0, 0.002, 0.006]
    tensions = []
    for shortening in ramp:
        result = pull(simulation, shortening, 0.0, 0.004, 0.0)
        assert result.status is Status.OK and result.efforts.min() >= 0.0
        tensions.append(result.efforts[0])
    assert tensions[5] < 0.5 * tensions[1]
    assert tensions[8] == pytest.approx(tensions[2], rel=0.05)


def test_restored_states_go_on_as_they_did(beam):
    simulation = beam(rubbing(0.3, 4, axial_stiffness=500.0))
    for shortening in (0.006, 0.009, 0.0085):
        pull(simulation, shortening, 0.0, 0.0, 0.0)
    state = simulation.state
    assert np.abs(state.memory[SHARES]).max() > 0.0
    first = [pull(simulation, s, 0.001, 0.0, 0.0) for s in (0.008, 0.0075)]
    simulation.restore(state)
    second = [pull(simulation, s, 0.001, 0.0, 0.0) for s in (0.008, 0.0075)]
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one.state.positions, other.state.positions)
        np.testing.assert_array_equal(one.state.memory[SHARES], other.state.memory[SHARES])
        np.testing.assert_array_equal(one.efforts, other.efforts)
    simulation.reset()
    assert not simulation.state.memory[SHARES].any()


def test_a_beam_in_motion_comes_to_rest_at_the_capstan_equation(beam):
    simulation = beam(rubbing(0.3, 10), {"integration": "dynamic", "body.damping": {"mass": 20.0}})
    for _ in range(60):
        lengths = simulation.rest_setpoints - [0.006, 0.0, 0.0, 0.0]
        result = simulation.step(CommandSetpoints(lengths, 0.02))
    assert result.status.is_success and np.abs(simulation.state.velocities).max() < 1e-3
    tensions, angles = of_east(simulation)
    least, most = (tensions[0] * np.exp(s * 0.3 * angles.sum()) for s in (-1, 1))
    assert least * (1 - 1e-9) <= tensions[-1] <= most * (1 + 1e-9)


# --- on frames ------------------------------------------------------------------------------------


@builder
def backbone(friction, joined=False) -> Simulation:
    """Makes a rod with two tendons beside it, along nine points each; perhaps with a ball at its end."""
    heights = np.linspace(0.0, 0.2, 9)
    cables = [
        {"name": name, "body": "rod", "pull_point": [x, 0.0, -0.01], "friction": friction,
         "points": [[x, 0.0, z] for z in heights], "shortening": [-0.02, 0.05]}
        for name, x in (("left", -0.004), ("right", 0.004))
    ]  # fmt: skip
    rod = {
        "name": "rod", "points": [[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]], "elements": 16,
        "section": {"circle": {"radius": 0.001}}, "fixed": ["start"],
        "material": {"young_modulus": 1e9, "poisson_ratio": 0.3, "density": 1000.0},
    }  # fmt: skip
    mapping = {
        "name": "backbone", "gravity": [0.0, 0.0, 0.0], "beams": [rod], "cables": cables,
        "effectors": [{"name": "tip", "body": "rod", "points": [[0.0, 0.0, 0.2]], "directions": ["x"]}],
        "solver": {"newton_iterations": 60, "residual_tolerance": 1e-8},
    }  # fmt: skip
    if joined:
        mapping["rigid_bodies"] = [{"name": "ball", "motion": "free", "mass": 0.01,
                                    "sphere": {"radius": 0.01}, "position": [0.0, 0.0, 0.2]}]  # fmt: skip
        rod["joined"] = [{"at": "end", "to": "ball"}]
        for cable in cables:
            cable["also_on"] = ["ball"]
    return Simulation(scene_from_mapping(mapping, None))


def pull_right(simulation, shortening):
    """Pulls one tendon and pays the other out, until it rests."""
    return repeat_step(simulation, CommandSetpoints(
        simulation.rest_setpoints - [-0.02, shortening], 0.1), 2)  # fmt: skip


@pytest.mark.parametrize("joined", [False, True])
def test_pulling_and_releasing_a_tendon_along_a_beam_give_the_capstan_equation(backbone, joined):
    simulation = backbone(0.3, joined)
    for way, last in ((1.0, np.linspace(0.001, 0.006, 6)), (-1.0, np.linspace(0.005, 0.001, 5))):
        for shortening in last:
            result = pull_right(simulation, shortening)
            assert result.status is Status.OK
        term = term_of(simulation)
        tensions, angles = term.tensions[9:], term.angles[9:]
        if way > 0.0:
            assert angles.sum() > 1.0
        assert tensions[-1] == pytest.approx(tensions[0] * np.exp(-way * 0.3 * angles.sum()), rel=1e-6)


def test_without_friction_the_term_bends_a_beam_as_plain_tendons_do(backbone):
    plain, tiny = backbone(0.0), backbone(1e-9)
    a, b = (pull_right(simulation, 0.005) for simulation in (plain, tiny))
    np.testing.assert_allclose(a.efforts, b.efforts, atol=1e-5)
    np.testing.assert_allclose(a.state.positions, b.state.positions, atol=1e-7)


def test_the_inverse_bends_a_beam_to_its_target_against_friction(backbone):
    simulation = backbone(0.3)
    target = simulation.effector_positions() + [0.05, 0.0, 0.0]
    result = repeat_step(simulation, FollowTargets(target, 0.1), 30)
    assert result.status.is_success and result.effector_errors[0] < 1e-5
    again = repeat_step(backbone(0.3), CommandSetpoints(result.setpoints, 0.1), 5)
    np.testing.assert_allclose(again.effector_positions[0, 0], target[0, 0], atol=2e-3)


def test_forces_and_lengths_on_a_beam_are_slopes(backbone):
    simulation = backbone(0.3)
    pull_right(simulation, 0.005)
    term, nodes, x = term_of(simulation), simulation.model.nodes, simulation.state.positions

    def held(tensions):
        forces = np.zeros((nodes.free_node_count, 3))
        term.tell_efforts(np.array(tensions))
        term.held_forces.add_forces(x, forces)
        return forces

    slope = (held([1e-9, 1.001]) - held([1e-9, 0.999])) / 2e-3
    held([1e-9, 1.0])
    rows = RowStack([term], nodes.carried)
    rows.evaluate(x)
    H = np.zeros((2, nodes.free_node_count, 3))
    np.add.at(H, (rows.row_index, rows.node_index), rows.blocks)
    np.testing.assert_allclose(H[1], slope, atol=1e-6)


def test_on_a_basis_that_spans_everything_friction_is_that_of_the_full_body(beam, tmp_path):
    full = beam(rubbing(0.3))
    reduced = saved_beside(full, spanning_basis(full.model.bodies[0]), tmp_path / "reduced.npz")
    for shortening in (0.004, 0.008, 0.006):
        a, b = (pull(simulation, shortening, 0.0, 0.0, 0.0) for simulation in (full, reduced))
        assert a.status is b.status is Status.OK
        np.testing.assert_allclose(b.efforts, a.efforts, atol=1e-5)
        np.testing.assert_allclose(b.effector_positions, a.effector_positions, atol=1e-7)
