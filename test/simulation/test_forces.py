"""Forces as actuators: on soft bodies, rigid bodies and beams, against closed forms."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from softrobot_twin.analysis.sensitivities import Sensitivities
from softrobot_twin.errors import SceneError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.scene_parameters import parameters
from softrobot_twin.simulation import (
    FollowTargets,
    Hold,
    Simulation,
)
from softrobot_twin.tables.run_columns import RunColumns
from test.builder import builder
from test.finite_differences import assert_slopes_of_actuators
from test.scene_changes import built, hold, repeat_step, solved

LENGTH, SIDE, E = 0.1, 0.01, 3e5
BENDING = E * SIDE**4 / 12.0
TIP = {"box": {"minimum": [-1, -1, LENGTH - 1e-6], "maximum": [1, 1, LENGTH + 1e-6]}}
TOP = [[0.0, 0.0, LENGTH], [SIDE, 0.0, LENGTH], [0.0, SIDE, LENGTH], [SIDE, SIDE, LENGTH]]


def force(**entries):
    """A force along x at the tip."""
    place = {} if {"points", "box", "sphere"} & set(entries) else TIP
    return {"name": "push", "direction": [1, 0, 0]} | place | entries


@builder
def column(*forces, change=None) -> Simulation:
    """Makes a slim upright column of soft rubber, clamped at its foot, with forces on it."""
    mapping = {
        "name": "column", "gravity": [0.0, 0.0, 0.0],
        "body": {
            "name": "column", "mesh": {"box": {"size": [SIDE, SIDE, LENGTH], "cells": [1, 1, 8]}},
            "material": {"young_modulus": E, "poisson_ratio": 0.0, "density": 1000.0},
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-6]}}],
        },
        "forces": list(forces) or [force()],
        "effectors": [{"name": "tip", "points": TOP}],
        "solver": {"newton_iterations": 40, "residual_tolerance": 1e-9},
    }  # fmt: skip
    return built(mapping, change)


@builder
def on_frames(turns, modulus=1e7) -> Simulation:
    """Makes a ball on a beam of two elements, with a force on each of them."""
    forces = [
        {"name": "on_ball", "body": "ball", "points": [[0.02, 0.01, 0.03]], "direction": [1, 2, 3]},
        {"name": "on_beam", "body": "leg", "points": [[0.01, 0.0, -0.1]], "direction": [1, 0, 0]},
    ]
    mapping = {
        "name": "frames", "gravity": [0.0, 0.0, 0.0],
        "rigid_bodies": [{"name": "ball", "motion": "free", "mass": 0.1, "sphere": {"radius": 0.03}}],
        "beams": [{
            "name": "leg", "points": [[0.0, 0.0, -0.2], [0.0, 0.0, 0.0]], "elements": 2,
            "section": {"rectangle": {"thickness": 0.005, "width": 0.01}}, "fixed": ["start"],
            "joined": [{"at": "end", "to": "ball"}], "thickness_direction": [1.0, 0.0, 0.0],
            "material": {"young_modulus": modulus, "poisson_ratio": 0.4, "density": 1000.0},
        }],
        "effectors": [{"name": "centre", "body": "ball", "points": [[0.0, 0.0, 0.0]]}],
        "forces": [{**one, "turns_with_body": turns} for one in forces],
        "solver": {"newton_iterations": 40, "residual_tolerance": 1e-9},
    }  # fmt: skip
    return Simulation(scene_from_mapping(mapping, None))


def test_a_small_force_bends_as_in_beam_theory_and_its_work_is_the_energy(column):
    simulation = column()
    result = hold(simulation, 1e-3)
    # Shear adds 6/5 F L/(G A) with G = E/2.
    bent = 1e-3 * (LENGTH**3 / (3.0 * BENDING) + 2.4 * LENGTH / (E * SIDE**2))
    assert result.displacements[0] == pytest.approx(bent, rel=0.02)
    energy = sum(term.energy(result.state.positions) for term in simulation.model.forces)
    assert 0.5 * 1e-3 * result.displacements[0] == pytest.approx(energy, rel=2e-3)


def test_a_patch_shares_a_force_by_area(column):
    by_box = column(force())
    by_points = column(force(points=[[SIDE / 2, SIDE / 2, LENGTH]]))
    sphere = {"centre": [SIDE / 2, SIDE / 2, LENGTH], "radius": 0.72 * SIDE}
    by_sphere = column(force(sphere=sphere))
    bent = [hold(one, 5e-3).effector_positions[0] for one in (by_box, by_points, by_sphere)]
    np.testing.assert_allclose(bent[1], bent[0], atol=2e-5)
    np.testing.assert_allclose(bent[2], bent[0], atol=2e-4)
    blocks, values = np.empty((len(by_box.actuators.terms[0].entry_rows), 3)), np.empty(1)
    by_box.actuators.terms[0].evaluate(by_box.state.positions, blocks, values)
    np.testing.assert_allclose(blocks.sum(axis=0), [1.0, 0.0, 0.0], atol=1e-12)


def test_points_bear_their_shares_of_a_force(column):
    given, repeated = (column(force(points=points, **shares)).model.actuators.terms[0]
                       for points, shares in ((TOP[:2], {"shares": [1.5, 0.5]}), ([*3 * TOP[:1], TOP[1]], {})))
    x = column().state.positions
    for one, other in zip(given.rows_at(x), repeated.rows_at(x), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-15)


def test_a_commanded_displacement_needs_the_force_that_leads_there(column):
    asked = hold(column(), 4e-3)
    other = hold(column(force(control="displacement")), asked.displacements[0])
    assert other.efforts[0] == pytest.approx(4e-3, rel=1e-6)
    np.testing.assert_allclose(other.state.positions, asked.state.positions, atol=1e-8)


def test_a_force_without_direction_is_three_that_follow_a_target(column):
    entry = force(force=[-1.0, 1.0], rate=0.5)
    del entry["direction"]
    simulation = column(entry)
    assert simulation.actuators.names == ("push_x", "push_y", "push_z")
    target = simulation.effector_positions() + [0.02, -0.01, -0.001]
    result = solved(simulation, FollowTargets(target, 0.05), 30)
    assert result.effector_errors[0] < 1e-5
    again = hold(column(entry), *result.efforts)
    np.testing.assert_allclose(again.effector_positions, target, atol=1e-5)


def test_limits_and_rates_of_a_force_are_kept_and_named(column):
    simulation = column(force(force=[-1e-3, 2e-3], rate=0.01))
    target = simulation.effector_positions() + [0.05, 0.0, 0.0]
    result = simulation.step(FollowTargets(target, 0.1))
    assert result.setpoints[0] == pytest.approx(1e-3) and result.report.active_limits == ("push.rate",)
    result = repeat_step(simulation, FollowTargets(target, 0.1), 5)
    assert result.setpoints[0] == pytest.approx(2e-3)
    assert result.report.active_limits == ("push.force_max",)


def turned_tip(load):
    """Tip of an elastica under a load F that stays across its end, by its length; load = F L²/EI.

    With the angle φ from the vertical, φ'' = -load cos(φ_tip - φ), and φ' = 0 at the tip, so that
    φ'²/2 = load sin(φ_tip - φ).
    """

    def bent(tip):
        def slopes(s, y):
            return [y[1], -load * np.cos(tip - y[0]), np.sin(y[0]), np.cos(y[0])]

        start = [0.0, np.sqrt(2.0 * load * np.sin(tip)), 0.0, 0.0]
        return solve_ivp(slopes, (0.0, 1.0), start, rtol=1e-9, atol=1e-11).y[:, -1]

    return bent(brentq(lambda tip: bent(tip)[1], 1e-3, 0.5 * np.pi))[2:]


def test_a_force_that_turns_bends_a_column_as_its_elastica(column):
    simulation = column(force(turns_with_body=True))
    for load in (1.0, 2.0):
        result = hold(simulation, load * BENDING / LENGTH**2)
        tip = result.effector_positions[0] - [SIDE / 2, SIDE / 2, 0.0]
        x, z = turned_tip(load)
        np.testing.assert_allclose(tip / LENGTH, [x, 0.0, z], atol=0.025)


@pytest.mark.parametrize("points", [{}, {"points": TOP}])
def test_rows_and_stiffness_on_a_soft_body_are_slopes(column, points):
    turning = column(force(**points, turns_with_body=True), force(**points, name="still"))
    for simulation in (column(force(**points)), turning):
        term, nodes = simulation.actuators.terms[0], simulation.model.nodes
        K = assert_slopes_of_actuators(term, nodes, np.array([2.0, 3.0])[: term.row_count], 1e-3)
        assert (np.abs(K).max() > 0.0) == (simulation is turning)


@pytest.mark.parametrize("turns", [False, True])
def test_rows_and_stiffness_on_frames_are_slopes(on_frames, turns):
    simulation = on_frames(turns)
    term, nodes = simulation.actuators.terms[0], simulation.model.nodes
    K = assert_slopes_of_actuators(term, nodes, np.array([2.0, 3.0]), 1e-2)
    assert np.abs(K).max() > 1e-3


@pytest.mark.parametrize("turns", [False, True])
def test_derivatives_beside_a_force_are_those_of_its_equilibria(column, on_frames, turns):
    def of_column(share):
        return column(force(turns_with_body=turns), change={"body.material.young_modulus": share * E})

    def of_beam(share):
        return on_frames(turns, 1e7 * share)

    for make, key, loads in ((of_column, "body.material.young_modulus", [5e-3]),
                             (of_beam, "beams[0].material.young_modulus", [0.01, 0.05])):  # fmt: skip
        ends = []
        for share in (1.0, 1.0 + 1e-4, 1.0 - 1e-4):
            simulation = make(share)
            hold(simulation, *loads)
            repeat_step(simulation, Hold(1.0), 3)
            ends.append(simulation)
        (parameter,) = parameters(ends[0].scene, key)
        found = Sensitivities(ends[0]).of_parameters([parameter]).effectors[0, :, 0]
        ahead, behind = (one.effector_positions()[0] for one in ends[1:])
        modulus = parameter.read(ends[0].scene)
        expected = (ahead - behind) / (2e-4 * modulus)
        np.testing.assert_allclose(found, expected, atol=2e-3 * np.abs(expected).max())


def test_columns_name_a_force_with_its_unit(column):
    entry = force(points=TOP, rate=2.0)
    del entry["direction"]
    simulation = column(entry)
    header = RunColumns(simulation).names
    assert header[header.index("push_x_force_N") :][:2] == ("push_x_force_N", "push_x_displacement_m")
    assert set(simulation.actuator_paths()) == {"push_x", "push_y", "push_z"}


@pytest.mark.parametrize("entry, key, why", [
    (force(direction=[0, 0, 0]), "forces[0].direction", "must not be zero"),
    (force(points=TOP, sphere={"centre": [0, 0, 0], "radius": 1.0}), "forces[0]", "exactly one of"),
    (force(turns_with_body=True, control="displacement"), "forces[0].control", "command and limit"),
    (force(turns_with_body=True, points=TOP[:2]), "forces[0].turns_with_body", "three or more"),
    (force(force=[1.0, 2.0]), "forces[0].force", "no force, 0, must lie within"),
    (force(points=[[0, 0, 0]]), "forces[0]", "lies wholly in what is fixed"),
    (force(points=[[0, 0, 1.0]]), "forces[0].points[0]", "outside the body"),
    (force(box={"minimum": [0, 0, 0.05], "maximum": [1, 1, 0.051]}), "forces[0].box", "no whole triangle"),
    (force(body="colum"), "forces[0].body", "is column meant"),
])  # fmt: skip
def test_a_force_that_cannot_act_is_refused(column, entry, key, why):
    with pytest.raises(SceneError) as refused:
        column(entry)
    assert key in str(refused.value) and why in str(refused.value)


def test_a_scene_without_forces_has_no_such_term_and_a_state_with_them_is_complete(column):
    simulation = column(change={"forces": []})
    assert not simulation.actuators.count
    simulation = column(force(turns_with_body=True))
    hold(simulation, 3e-3)
    state = simulation.state
    one = simulation.step(Hold(0.1))
    simulation.restore(state)
    assert simulation.step(Hold(0.1)).state.positions.tobytes() == one.state.positions.tobytes()
