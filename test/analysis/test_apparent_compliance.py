"""What effectors yield to forces while actuators hold, against small pushes in statics."""

import numpy as np
import pytest

from softrobot_twin.analysis.apparent_compliance import EffectorCompliance, apparent_compliance
from softrobot_twin.constraints.row_stack import add_row_forces
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandEfforts, CommandSetpoints, Hold, Simulation
from test.places import SCENES
from test.scene_changes import LEFT_OUT, changed, repeat_step


class Push(ForceTerm):
    """A constant force on each effector."""

    name = "push"

    def __init__(self, simulation: Simulation):
        self._rows = EffectorCompliance(simulation).own_rows
        self.force = np.zeros(self._rows.row_count)

    def stencils(self):
        return np.empty((0, 1), np.int64)

    def add_forces(self, positions, forces):
        rows = self._rows
        rows.evaluate(positions)
        add_row_forces(rows.row_index, rows.node_index, rows.blocks, self.force, forces)
        return 0

    def add(self, positions, forces, storage, projected):
        self.add_forces(positions, forces)

    def energy(self, positions):
        self._rows.evaluate(positions)
        return -float(self._rows.values @ self.force)


def rest_of(simulation, command=None, steps=30):
    """Where the effectors come to rest [m], shape (effector_count, 3)."""
    for _ in range(steps):
        result = simulation.step(command or Hold(0.1))
        if result.report.residual < 1e-11 and result.status.is_success:
            break
    assert result.report.residual < 1e-8, result.status
    return result.effector_positions


def go_to(simulation, drives, steps=30):
    """Bring the actuators to displacements, or efforts of those that have them, and to rest."""
    setpoints = simulation.actuators.setpoints(np.asarray(drives, float))
    for _ in range(steps):
        simulation.step(CommandSetpoints(setpoints, 0.1))
        if np.allclose(simulation.state.setpoints, setpoints, rtol=0.0, atol=1e-12):
            break
    # The stretch of cables and the stiffness by contacts follow the forces of the step before.
    simulation.step(Hold(0.1))
    rest_of(simulation)


def pushed(simulation, force, command=None):
    """∂x/∂f of every effector by differences; the force is the step [N]."""
    push, before = Push(simulation), simulation.model.forces
    simulation.model.forces = (*before, push)
    start, columns = simulation.state, []
    for row in range(len(push.force)):
        ends = []
        for sign in (1.0, -1.0):
            simulation.restore(start)
            push.force[row] = sign * force
            ends.append(rest_of(simulation, command))
        push.force[row] = 0.0
        columns.append((ends[0] - ends[1])[row // 3] / (2.0 * force))
    simulation.model.forces = before
    simulation.restore(start)
    rest_of(simulation, command)
    return np.array(columns).reshape(-1, 3, 3).transpose(0, 2, 1)


def moved(simulation, steps):
    """∂x/∂δ_a by differences, one of these steps for each actuator."""
    start, columns = simulation.state, []
    actuators = simulation.actuators
    for index, step in enumerate(steps):
        ends = []
        for sign in (1.0, -1.0):
            simulation.restore(start)
            drives = actuators.drives(start.setpoints).copy()
            drives[index] += sign * step
            go_to(simulation, drives)
            ends.append(simulation.effector_positions())
        columns.append((ends[0] - ends[1]) / (2.0 * step))
    simulation.restore(start)
    rest_of(simulation)
    return np.array(columns).transpose(1, 2, 0)


def assert_same(found, differences, share=1e-5):
    greatest = np.abs(differences).max()
    np.testing.assert_allclose(found, differences, rtol=0.0, atol=share * greatest)


def check(simulation, force, steps, share=1e-5):
    """Compliance and Jacobian against differences, also by the factorization of the last step."""
    found = apparent_compliance(simulation)
    assert_same(found.compliance, pushed(simulation, force), share)
    assert_same(found.jacobian, moved(simulation, steps), share)
    simulation.step(Hold(0.1))
    after = EffectorCompliance(simulation).after_step()
    assert_same(after.compliance, found.compliance, 1e-7)
    assert_same(after.jacobian, found.jacobian, 1e-7)
    np.testing.assert_allclose(
        found.compliance, found.compliance.transpose(0, 2, 1), rtol=0.0,
        atol=1e-9 * np.abs(found.compliance).max(),
    )  # fmt: skip
    return found


exact = changed({"solver": {"newton_iterations": 30, "residual_tolerance": 1e-11}})
quadratic = changed(exact, {"body.element": "quadratic"})


@pytest.mark.parametrize("change", [exact, quadratic])
def test_pushed_between_taut_and_slack_cables(beam, change):
    simulation = beam(change)
    go_to(simulation, [0.007, 0.006, 0.001, 0.0005])
    assert simulation.newton.tangent.static_factorization is not None
    found = check(simulation, 1e-4, np.full(4, 1e-6))
    held = simulation.state.efforts > 0.0
    assert found.is_held.tolist() == held.tolist() and held.any() and not held.all()
    assert not found.jacobian[:, :, ~held].any() and found.jacobian[:, :, held].any()


def test_all_three_coordinates_count_whatever_the_scene_controls(beam):
    def change(mapping):
        exact(mapping)
        mapping["effectors"][0]["directions"] = ["x"]
        mapping["effectors"].append(
            {"name": "middle", "points": [[0.01, 0.01, 0.06]], "directions": ["z"], "weight": 0.1}
        )

    partial, whole = beam(change), beam(exact)
    for simulation in (partial, whole):
        go_to(simulation, [0.006, 0.0, 0.0, 0.0])
    found = apparent_compliance(partial)
    assert found.compliance.shape == (2, 3, 3) and found.jacobian.shape == (2, 3, 4)
    np.testing.assert_allclose(
        found.compliance[0], apparent_compliance(whole).compliance[0], rtol=1e-7
    )
    assert_same(found.compliance, pushed(partial, 1e-4))


def test_a_cable_that_is_neither_slack_nor_tense_holds_nothing_and_still_pulls(beam):
    simulation = beam(exact)
    rest_of(simulation)
    found = apparent_compliance(simulation)
    assert not found.is_held.any()
    pulls = np.empty((3, 4))
    rest = simulation.effector_positions()[0]
    for index in range(4):
        simulation.reset()
        go_to(simulation, 1e-7 * np.eye(4)[index])
        pulls[:, index] = (simulation.effector_positions()[0] - rest) / 1e-7
    assert_same(found.jacobian[0], pulls, 1e-4)


def test_a_contact_that_presses_holds_its_gap(beam, rod):
    change = changed(exact, lambda m: rod(m, x=0.028, radius=0.005), {"contact.tolerance": 1e-12})
    simulation, free = beam(change), beam(exact)
    for each in (simulation, free):
        go_to(each, [0.009, 0.0, 0.0, 0.0])
    found = check(simulation, 1e-3, np.full(4, 1e-5), 1e-3)
    assert found.contact_count > 0
    assert found.compliance[0, 0, 0] < 0.5 * apparent_compliance(free).compliance[0, 0, 0]


def test_a_cable_that_stretches_holds_less(beam):
    def stretch(stiffness):
        return changed(exact, {"cables.*.axial_stiffness": stiffness})

    soft, stiff = beam(stretch(30.0)), beam(stretch(1e7))
    for simulation in (soft, stiff):
        go_to(simulation, [0.006, 0.005, 0.0, 0.0])
    found = check(soft, 1e-4, np.full(4, 1e-6))
    rigid = apparent_compliance(stiff)
    assert np.linalg.eigvalsh(found.compliance[0] - rigid.compliance[0])[0] > -1e-9
    assert found.compliance[0, 0, 0] > 1.01 * rigid.compliance[0, 0, 0]


def test_tension_that_is_commanded_holds_no_length(beam):
    simulation = beam(exact)
    efforts = np.array([2.0, 1.0, 0.0, 0.0])
    command = CommandEfforts(efforts, 0.1)
    rest_of(simulation, command)
    found = apparent_compliance(simulation, np.ones(4, bool))
    assert not found.is_held.any() and found.is_by_effort.all()
    assert_same(found.compliance, pushed(simulation, 1e-4, command))
    stiffer = apparent_compliance(simulation)
    assert stiffer.is_held.tolist() == [True, True, False, False]
    assert stiffer.compliance[0, 0, 0] < found.compliance[0, 0, 0]
    ends = [rest_of(simulation, CommandEfforts(efforts + [pull, 0.0, 0.0, 0.0], 0.1))[0]
            for pull in (1e-4, -1e-4)]  # fmt: skip
    assert_same(found.jacobian[0, :, 0], (ends[0] - ends[1]) / 2e-4)


def test_with_friction_a_small_push_lets_the_cables_stick(beam):
    def change(mapping):
        for cable in mapping["cables"]:
            for index, point in enumerate(cable["points"]):
                share = 0.5 if index % 2 else 1.0
                point[:2] = [0.01 + share * (point[0] - 0.01), 0.01 + share * (point[1] - 0.01)]
            cable.update(friction=0.3, presliding=0.05)
        mapping["solver"] = {"newton_iterations": 30, "residual_tolerance": 1e-9}

    simulation = beam(change)
    go_to(simulation, [0.006, 0.003, 0.0, 0.0])
    assert simulation.newton.tangent.static_factorization is None
    push, forces = Push(simulation), simulation.model.forces
    found, start = apparent_compliance(simulation), simulation.state
    simulation.model.forces = (*forces, push)
    for axis in range(3):
        ends = []
        for force in (0.0, 1e-3):
            simulation.restore(start)
            push.force[:] = 0.0
            push.force[axis] = force
            ends.append(rest_of(simulation)[0])
        assert_same(found.compliance[0, :, axis], (ends[1] - ends[0]) / 1e-3, 2e-2)


@pytest.mark.parametrize("control", ["pressure", "volume"])
def test_a_cavity_holds_its_pressure_or_its_volume(two_cavities, control):
    simulation = two_cavities(exact, {"cavities.*.control": control, "cavities.*.rate": None})
    amount, step = (4e3, 1.0) if control == "pressure" else (4e-7, 1e-10)
    go_to(simulation, [amount, 0.25 * amount])
    found = check(simulation, 1e-4, [step, step])
    assert found.is_by_effort.all() == (control == "pressure")
    assert found.is_held[0] == (control == "volume")


def test_motors_of_hinges_hold_beams():
    simulation = Simulation(load_scene(SCENES / "strider.yaml"), with_warnings=False)
    go_to(simulation, [0.3, 0.1, -0.2, 0.05])
    found = check(simulation, 1e-5, np.full(4, 1e-6), 1e-4)
    assert found.is_held.all()


def test_a_body_reduced_to_vertebrae():
    simulation = Simulation(load_scene(SCENES / "fetch_reduced.yaml"), with_warnings=False)
    go_to(simulation, [2e3, 1e3, 500.0, 200.0, 800.0, 300.0])
    check(simulation, 1e-4, np.full(6, 1.0), 1e-4)


@pytest.mark.exhaustive
def test_the_flexo_of_ribs_hubs_and_fingers():
    simulation = Simulation(load_scene(SCENES / "flexo.yaml"), with_warnings=False)
    drives = np.zeros(12)
    drives[[0, 1, 4, 5, 6]] = 0.008
    go_to(simulation, drives)
    found = apparent_compliance(simulation)
    assert_same(found.compliance, pushed(simulation, 1e-5), 1e-4)
    assert 0 < np.count_nonzero(found.is_held) < 12


moving = changed(exact, {
    "integration": "dynamic", "body.damping": {"mass": 1.0, "stiffness": 0.01},
})  # fmt: skip


def test_in_motion_it_is_the_compliance_of_statics(beam):
    still, dynamic = beam(exact), beam(moving)
    go_to(still, [0.006, 0.005, 0.0, 0.0])
    found = apparent_compliance(still)
    lengths = dynamic.actuators.setpoints(np.array([0.006, 0.005, 0.0, 0.0]))
    repeat_step(dynamic, CommandSetpoints(lengths, 0.1), 400)
    assert dynamic.newton.tangent.static_factorization is None
    for seen in (apparent_compliance(dynamic), EffectorCompliance(dynamic).after_step()):
        assert_same(seen.compliance, found.compliance, 1e-6)
        assert_same(seen.jacobian, found.jacobian, 1e-6)


def walk(simulation, ask):
    """Positions of some steps, with or without questions in between."""
    reader, visited = EffectorCompliance(simulation), []
    for index in range(12):
        drives = [0.001 * index, 0.0005 * index, 0.0, 0.0]
        simulation.step(CommandSetpoints(simulation.actuators.setpoints(np.array(drives)), 0.02))
        if ask:
            getattr(reader, "at_state" if index % 2 else "after_step")()
        visited.append(simulation.state.positions)
    return np.array(visited)


@pytest.mark.parametrize("scheme", ["statics", "backward_euler", "generalized_alpha"])
def test_asking_changes_nothing_of_the_next_steps(beam, rod, scheme):
    def change(mapping):
        rod(mapping, x=0.028, friction=0.4)
        if scheme != "statics":
            moving(mapping)
            mapping["time_scheme"] = scheme

    asked, alone = beam(change), beam(change)
    np.testing.assert_array_equal(walk(asked, True), walk(alone, False))


def test_what_is_free_does_not_hide_the_stiffness_of_the_robot(beam):
    def change(mapping):
        moving(mapping)
        mapping["rigid_bodies"] = [
            {"name": "ball", "sphere": {"radius": 0.01}, "mass": 0.01, "position": [0.2, 0.0, 0.5]}
        ]
    without = changed(change, {"rigid_bodies": LEFT_OUT})
    found, alone = (apparent_compliance(beam(each)) for each in (change, without))
    assert_same(found.compliance, alone.compliance, 1e-6)


def test_a_scene_without_effectors_has_none(beam):
    simulation = beam(lambda mapping: mapping.pop("effectors"))
    simulation.step(Hold())
    found = apparent_compliance(simulation)
    assert found.compliance.shape == (0, 3, 3) and found.jacobian.shape == (0, 3, 4)


def test_an_effector_on_what_is_fixed_yields_to_nothing(beam):
    def change(mapping):
        mapping["effectors"].append({"name": "foot", "points": [[0.01, 0.01, 0.0]]})

    found = apparent_compliance(beam(change))
    assert not found.compliance[1].any() and not found.jacobian[1].any()
    stiffness, _ = found.principal_stiffness(1)
    assert np.isinf(stiffness).all()


@pytest.mark.exhaustive
def test_where_only_taut_cables_stabilise_the_body(diamond):
    simulation = diamond({"body.mesh.file": "../../meshes/diamond_1600.vtk"}, exact)
    go_to(simulation, [0.0171, 0.0007, 0.0146, 0.0035])
    assert simulation.newton.tangent.static_factorization is None  # The tangent of the last step was augmented.
    found = apparent_compliance(simulation)
    assert_same(found.compliance, pushed(simulation, 1e-4))
    assert found.principal_stiffness(0)[0][0] > 0.0
