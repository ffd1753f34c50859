"""The predicted sag of a body under its weight."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold
from softrobot_twin.simulation.scene_warnings import (
    LINEAR_SHARE,
    equilibrium_sag,
    expected_sag,
    linear_sag,
)
from test.builder import builder
from test.scene_changes import in_balance, repeat_step

LENGTH, SIDE, DENSITY = 0.2, 0.02, 1000.0


@builder
def cantilever(simulate, body_of, block, /, young_modulus, element="quadratic", held=True,
               cells=(8, 1, 1), **entries):  # fmt: skip
    """Makes a beam along x that sticks out of a wall; more entries may be given."""
    mesh = block(size=(LENGTH, SIDE, SIDE), cells=cells, shake=0.0)
    wall = [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-9, 1, 1]}}]
    body = body_of(mesh, "beam", young_modulus, 0.3, element=element,
                   **({"fixed": wall} if held else {}))  # fmt: skip
    return simulate(body=body, **entries)


def settled_sag(simulation):
    """Sag in the simulation itself [m]."""
    result = in_balance(simulation, Hold(), 40)
    way = result.state.positions - simulation.model.nodes.rest_positions
    return np.linalg.norm(way, axis=1).max()


@pytest.mark.parametrize("element", ["linear", "smoothed", "quadratic"])
@pytest.mark.parametrize("young_modulus", [1e7, 1e6, 3e5, 1e5, 3e4, 1e4])
def test_the_expected_sag_is_that_of_the_simulation(cantilever, element, young_modulus):
    simulation = cantilever(young_modulus, element)
    expected = expected_sag(simulation.model)
    small = expected <= LINEAR_SHARE * simulation.model.nodes.size
    assert expected == pytest.approx(settled_sag(simulation), rel=0.1 if small else 1e-3)


@pytest.mark.exhaustive
@pytest.mark.parametrize("size, cells", [((0.2, 0.01, 0.01), (40, 2, 2)),
                                         ((0.1, 0.1, 0.004), (20, 20, 1))])  # fmt: skip
def test_thin_rubber_has_the_sag_of_the_simulation(simulate, size, cells):
    body = {
        "mesh": {"box": {"size": list(size), "cells": list(cells)}}, "element": "quadratic",
        "material": {"preset": "dragon_skin_30"},
        "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-9, 1, 1]}}],
    }  # fmt: skip
    simulation = simulate(body=body, gravity=[0, 0, -9.81], solver={"newton_iterations": 10})
    assert not any("no equilibrium" in note for note in simulation.notes)
    expected = expected_sag(simulation.model)
    assert expected > 0.7 * size[0]
    assert expected == pytest.approx(settled_sag(simulation), rel=1e-3)


def test_a_stiff_beam_sags_as_beam_theory_predicts(cantilever):
    simulation = cantilever(1e7, cells=(16, 2, 2))
    weight, inertia = DENSITY * 9.81 * SIDE**2, SIDE**4 / 12.0
    bending = weight * LENGTH**4 / (8.0 * 1e7 * inertia)
    shear = weight * LENGTH**2 / (2.0 * 5.0 / 6.0 * 1e7 / 2.6 * SIDE**2)
    assert expected_sag(simulation.model) == pytest.approx(bending + shear, rel=0.02)


def test_one_linear_solve_of_a_soft_beam_overestimates_its_sag_several_times(cantilever):
    simulation = cantilever(5e4)
    assert linear_sag(simulation.model) > 4.0 * settled_sag(simulation)
    note = next(note for note in simulation.notes if "sags" in note)
    assert f"{equilibrium_sag(simulation.model):.3g} m" in note


def test_the_collapse_of_a_body_is_reported_without_a_sag(cantilever):
    simulation = cantilever(300.0)
    assert expected_sag(simulation.model) is None
    assert any("no equilibrium of the body" in note and "units" in note for note in simulation.notes)


def test_an_unheld_body_has_no_sag_and_a_weightless_one_has_zero_sag(cantilever):
    assert expected_sag(cantilever(1e5, held=False, integration="dynamic").model) is None
    assert expected_sag(cantilever(1e5, gravity=[0, 0, 0]).model) < 1e-12


def test_the_sag_of_a_dynamic_scene_is_the_static_one(cantilever):
    moving = cantilever(3e5, integration="dynamic")
    static = expected_sag(cantilever(3e5).model)
    repeat_step(moving, Hold(0.01), 3)
    before = moving.state
    assert expected_sag(moving.model) == pytest.approx(static, rel=1e-9)
    # The prediction does not change the simulation.
    after = moving.step(Hold(0.01)).state
    moving.restore(before)
    np.testing.assert_array_equal(moving.step(Hold(0.01)).state.positions, after.positions)


def test_a_free_rigid_body_does_not_change_the_sag_of_a_soft_body(cantilever):
    ball = [{"name": "ball", "sphere": {"radius": 0.01}, "mass": 0.1, "position": [0, 1, 0]}]
    simulation = cantilever(3e5, rigid_bodies=ball, integration="dynamic")
    alone = expected_sag(cantilever(3e5).model)
    assert expected_sag(simulation.model) == pytest.approx(alone, rel=1e-6)


def test_gas_that_is_sealed_in_a_body_stiffens_its_sag(simulate, hollow, settle):
    sags = []
    for entries in ({}, {"ambient_pressure": 1.0e5}):
        soft, surface = hollow(young_modulus=4.0e4)
        gas = [{"name": "gas", "walls": [{"file": surface}], **entries}] if entries else []
        simulation = simulate(body=soft, gravity=[0.0, 0.0, -9.81], sealed_cavities=gas)
        sags.append(equilibrium_sag(simulation.model))
        state = settle(simulation).state
        sunk = state.positions - simulation.model.nodes.rest_positions
        assert sags[-1] == pytest.approx(np.linalg.norm(sunk, axis=1).max(), rel=1e-4)
    assert 0.0 < sags[1] < sags[0]


DOWN = ((0, 0, 0), (0, 0, -0.1))


def on_joint(to="world", **joint) -> dict:
    return {"joined": [{"at": "start", "to": to, **joint}]}


@pytest.mark.parametrize(("scene", "held"), [
    ({"beams": [("rod", DOWN, {"fixed": ["start"]})]}, True),
    ({"beams": [("rod", DOWN, on_joint(by="hinge", axis=[0, 1, 0]))]}, True),
    ({"beams": [("rod", DOWN, on_joint(by="ball"))]}, True),
    ({"beams": [("rod", DOWN, on_joint("hub", by="hinge", axis=[0, 1, 0]))], "hub": "guided"}, True),
    ({"beams": [("rod", DOWN, on_joint("hub", by="hinge", axis=[0, 1, 0]))], "hub": "free"}, False),
    ({"beams": [("rod", DOWN, on_joint("hub"))], "hub": "free"}, False),
    ({"beams": [("upper", DOWN, {"fixed": ["start"]}),
                ("rod", (DOWN[1], (0, 0, -0.2)), on_joint("upper", by="ball"))]}, True),
    ({"beams": [("rod", DOWN, {})]}, False),
])  # fmt: skip
def test_a_beam_that_hangs_on_a_joint_is_held(simulate, scene, held):
    beams = [
        {"name": name, "points": [list(map(float, p)) for p in points], "elements": 4,
         "section": {"circle": {"radius": 0.002}},
         "material": {"young_modulus": 1e7, "poisson_ratio": 0.4, "density": 1000.0}, **entries}
        for name, points, entries in scene["beams"]
    ]  # fmt: skip
    hub = {"name": "hub", "motion": scene.get("hub"), "position": [0, 0, 0], "sphere": {"radius": 0.01}}
    if scene.get("hub") == "free":
        hub["mass"] = 0.01
    rigid = {"rigid_bodies": [hub]} if "hub" in scene else {}
    model = simulate(integration="dynamic", gravity=[0, 0, -9.81], beams=beams, **rigid).model
    sag = expected_sag(model)
    assert model.is_held == held == (sag is not None)
    if held:
        assert sag < 1e-4  # it only stretches
