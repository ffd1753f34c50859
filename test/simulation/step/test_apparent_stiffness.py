"""The stiffness that a touch feels, and its derivatives: against forces, and against equilibria."""

import copy
import time

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation, Status, Touched
from softrobot_twin.simulation.step.apparent_stiffness import ApparentStiffness
from softrobot_twin.simulation.step.augmented_tangent import HeldActuators
from softrobot_twin.simulation.step.time_budget import StageClock
from test.places import SCENES
from test.scene_changes import changed, entries_of

ALL_AXES = np.arange(3)


def shipped(name, change):
    """A shipped scene with changes, converged in every step."""
    file = SCENES / f"{name}.yaml"
    mapping = entries_of(file, {"solver": {"newton_iterations": 60, "residual_tolerance": 1e-11}})
    change(mapping)
    return Simulation(scene_from_mapping(mapping, file))


coarse_diamond = changed({"body.mesh.file": "../../meshes/diamond_400.vtk", "body.element": "linear"})


def fine_diamond(mapping):
    mapping["body"] |= {"element": "linear", "mesh": {"file": "../../meshes/diamond_1600.vtk"}}


soft_diamond = changed(coarse_diamond, {"body.material.law": "neo_hookean"})


CASES = {
    "diamond": ("diamond", coarse_diamond, [0.012, 0.004, 0.008, 0.006]),
    "neo-hookean diamond": ("diamond", soft_diamond, [0.012, 0.004, 0.008, 0.006]),
    "stifface": ("stifface", lambda mapping: None,
                 [0.002, 0.0015, 0.0025, 0.002, 0.002, 0.0025, 0.0023, 0.0022]),
}  # fmt: skip


@pytest.fixture(scope="module", params=CASES)
def pulled(request):
    """A robot, the lengths that it holds its cables at, and its stiffness there."""
    name, change, shortening = CASES[request.param]
    simulation = shipped(name, change)
    lengths = simulation.rest_setpoints - np.array(shortening)
    settle(simulation, lengths)
    assert (simulation.state.efforts > 0.1).all()
    return simulation, lengths, ApparentStiffness(simulation.model)


def settle(simulation, lengths):
    for _ in range(30):
        result = simulation.step(CommandSetpoints(lengths, 10.0))
        if result.status is Status.OK and (result.setpoints == lengths).all():
            return
    raise AssertionError(f"{result.status}, residual {result.report.residual} N")


def linearized(simulation, lengths=None):
    """The state; where lengths are given, its tangent may be augmented by the rows of the cables."""
    newton, state, held = simulation.newton, simulation.state, None
    if lengths is not None:
        drives = simulation.actuators.drives(lengths)
        reach = simulation.limits.bounds(drives, 0.0)
        held = HeldActuators(drives, reach, reach, True)
    newton.linearize(state.positions, state.efforts, StageClock(time.perf_counter), held=held)
    return newton.tangent.linearized_state(state.positions, state.efforts)


def test_it_is_what_a_force_meets_while_the_cables_hold_their_lengths(pulled):
    simulation, lengths, stiffness = pulled
    settle(simulation, lengths)
    state = linearized(simulation)
    found = stiffness.gradient(state, ALL_AXES).compliance
    # By matrices of all unknowns: A x - Hᵀ Λ = e, H x = 0.
    linear = state.linear
    count, rows = linear.groups.actuators.stop, simulation.model.rows
    loads = np.stack([stiffness.load(axis) for axis in ALL_AXES])
    x = np.stack([state.solver.solve(load) for load in loads])
    W_ee = np.einsum("inx,jnx->ij", loads, x)
    W_ae = np.zeros((count, 3))
    own = rows.row_index < count
    for axis in ALL_AXES:
        moved = np.einsum("ij,ij->i", rows.blocks[own], x[axis][rows.node_index[own]])
        W_ae[:, axis] = np.bincount(rows.row_index[own], moved, count)
    C = W_ee - W_ae.T @ np.linalg.solve(linear.W_aa, W_ae)
    np.testing.assert_allclose(found, C.diagonal(), rtol=1e-6)


def slopes_by_lengths(simulation, stiffness, lengths, is_held=False, step=1.0e-5):
    """Of the compliance by what each cable is shortened, from equilibria at other lengths."""
    columns = []
    for cable in range(len(lengths)):
        sides = []
        for sign in (1.0, -1.0):
            other = lengths.copy()
            other[cable] -= sign * step
            settle(simulation, other)
            state = linearized(simulation, other if is_held else None)
            sides.append(stiffness.gradient(state, ALL_AXES).compliance)
        columns.append((sides[0] - sides[1]) / (2.0 * step))
    return np.column_stack(columns)


def test_its_derivatives_are_those_of_equilibria_at_other_lengths(pulled):
    simulation, lengths, stiffness = pulled
    settle(simulation, lengths)
    state = linearized(simulation)
    gradient = stiffness.gradient(state, ALL_AXES)
    # Held cables change their efforts by W_aa⁻¹ times what their lengths are changed by.
    found = gradient.by_multiplier @ np.linalg.inv(state.linear.W_aa)
    expected = slopes_by_lengths(simulation, stiffness, lengths)
    settle(simulation, lengths)
    assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max()


def test_the_linearization_begins_at_the_state(pulled):
    simulation, lengths, stiffness = pulled
    settle(simulation, lengths)
    state = linearized(simulation)
    found = stiffness.gradient(state, ALL_AXES)
    here = found.free + found.by_multiplier @ state.efforts
    np.testing.assert_allclose(here, found.compliance, rtol=1e-9)


@pytest.mark.exhaustive
def test_its_derivatives_are_right_where_the_tangent_alone_is_indefinite():
    simulation = shipped("diamond", fine_diamond)
    stiffness = ApparentStiffness(simulation.model)
    lengths = simulation.rest_setpoints - 1e-3 * np.array([16.3, 18.3, 12.1, 14.6])
    settle(simulation, lengths)
    state = linearized(simulation, lengths)
    assert simulation.newton.tangent.is_augmented
    gradient = stiffness.gradient(state, ALL_AXES)
    here = gradient.free + gradient.by_multiplier @ simulation.state.efforts
    np.testing.assert_allclose(here, gradient.compliance, rtol=1e-8)
    # The multipliers of the augmented system change by the inverse of its own compliance.
    found = gradient.by_multiplier @ np.linalg.inv(state.linear.W_aa)
    expected = slopes_by_lengths(simulation, stiffness, lengths, is_held=True)
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()


def test_a_finger_that_presses_the_pad_meets_it():
    simulation = shipped("stifface", lambda mapping: None)
    lengths = simulation.rest_setpoints - CASES["stifface"][2]
    settle(simulation, lengths)
    state, moved = linearized(simulation), []
    (compliance,) = ApparentStiffness(simulation.model).gradient(state, ALL_AXES[2:]).compliance
    for force in (1e-3, -1e-3):
        for _ in range(3):
            touched = Touched(np.array([[0.0, 0.0, force]]), np.full((1, 3), np.nan))
            simulation.step(CommandSetpoints(lengths, 10.0), measured=touched)
        moved.append(simulation.effector_positions()[0, 2])
    assert moved[0] - moved[1] == pytest.approx(2e-3 * compliance, rel=1e-4)


def test_a_slack_cable_holds_nothing():
    simulation = shipped("diamond", coarse_diamond)
    stiffness = ApparentStiffness(simulation.model)
    settle(simulation, simulation.rest_setpoints - [0.01, 0.0, 0.01, 0.0])
    slack = simulation.state.efforts == 0.0
    assert slack.tolist() == [False, True, False, True]
    state = linearized(simulation)
    assert stiffness.holds(state.efforts).tolist() == (~slack).tolist()
    found = stiffness.gradient(state, ALL_AXES).compliance
    held = stiffness.gradient(state._replace(efforts=np.ones(4)), ALL_AXES).compliance
    assert (found > (1.0 + 1e-6) * held).any()


def test_a_cable_that_a_small_push_makes_slack_holds_nothing():
    """At a tension of 1e-7 N it would resist one way and not the other."""
    simulation = shipped("diamond", coarse_diamond)
    stiffness = ApparentStiffness(simulation.model)
    settle(simulation, simulation.rest_setpoints - [0.01, 0.0, 0.01, 0.0])
    state, efforts = linearized(simulation), simulation.state.efforts
    slack = efforts == 0.0
    found = stiffness.gradient(state, ALL_AXES).compliance
    for tension, is_held in ((1e-7, False), (1.0, True)):
        pulled = state._replace(efforts=np.where(slack, tension, efforts))
        assert stiffness.holds(pulled.efforts).all()
        compliance = stiffness.gradient(pulled, ALL_AXES).compliance
        assert np.allclose(compliance, found, rtol=1e-6) != is_held


@pytest.mark.parametrize("law", ["corotational", "neo_hookean"])
def test_its_derivative_by_the_pressure_of_a_cavity_is_that_of_equilibria(inflatable, law):
    """What is driven by its pressure keeps it: dC/dp at given pressures."""
    simulation = inflatable({
        "body.material.law": law, "effectors": [{"name": "top", "points": [[0.01, 0.01, 0.06]]}],
        "solver": {"newton_iterations": 60, "residual_tolerance": 1e-12}})  # fmt: skip
    stiffness = ApparentStiffness(simulation.model)
    pressure, found = 5.0e3, {}
    for p in (pressure - 10.0, pressure + 10.0, pressure):
        settle(simulation, np.array([p]))
        found[p] = stiffness.gradient(linearized(simulation), ALL_AXES)
    expected = (found[pressure + 10.0].compliance - found[pressure - 10.0].compliance) / 20.0
    here = found[pressure]
    assert np.abs(here.by_multiplier[:, 0] - expected).max() < 1e-5 * np.abs(expected).max()
    assert not stiffness.holds(simulation.state.efforts[:1]).any()


REFUSED = {
    "dynamic": ({"integration": "dynamic"}, "quasi_static"),
    "contact": ({
        "obstacles": [{"name": "floor", "plane": {}, "position": [0, 0, -1.0]}],
        "contact": {"between": [{"pair": ["body", "floor"]}]},
    }, "contact"),
    "elastic": ({}, "stretch"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_scenes_that_it_is_not_built_for_are_refused_by_name(case):
    def change(mapping):
        coarse_diamond(mapping)
        more = copy.deepcopy(REFUSED[case][0])
        mapping["body"]["name"] = "body"
        if case == "elastic":
            mapping["cables"][0]["axial_stiffness"] = 2000.0
        mapping.update(more)
        mapping["effectors"][0]["stiffness"] = {"target": [None, None, 300.0]}

    with pytest.raises(SceneError, match=f"effectors.0..stiffness.*{REFUSED[case][1]}"):
        shipped("diamond", change)
