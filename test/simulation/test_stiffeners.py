"""Stiffeners as actuators: Young's modulus of a region as a command."""

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import FollowTargets, Hold, Simulation
from softrobot_twin.tables.run_columns import RunColumns
from test.builder import builder
from test.finite_differences import assert_slopes_of_actuators
from test.scene_changes import built, hold, repeat_step, solved

LENGTH, SIDE, E = 0.1, 0.02, 1e5
ROOT = {"minimum": [-1, -1, -1], "maximum": [LENGTH / 2, 1, 1]}
TIP = [[LENGTH, SIDE / 2, SIDE / 2]]


def jam(**entries):
    """A stiffener of the half of the beam that is held."""
    return {"name": "jam", "box": ROOT, "young_modulus": [1e4, 1e6]} | entries


@builder
def beam(*stiffeners, change=None, cells=(6, 1, 1)) -> Simulation:
    """Makes a beam that sags by its weight, of two materials."""
    mapping = {
        "name": "beam", "gravity": [0.0, 0.0, -9.81],
        "body": {
            "name": "beam", "mesh": {"box": {"size": [LENGTH, SIDE, SIDE], "cells": list(cells)}},
            "material": {"young_modulus": 2e5, "poisson_ratio": 0.4, "density": 1000.0},
            "materials": [{"box": ROOT, "young_modulus": E}],
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-6, 1, 1]}}],
        },
        "stiffeners": list(stiffeners),
        "effectors": [{"name": "tip", "points": TIP, "directions": ["z"]}],
        "solver": {"newton_iterations": 60, "residual_tolerance": 1e-9},
    }  # fmt: skip
    return built(mapping, change)


@pytest.mark.sampled
@pytest.mark.parametrize("change", [
    {}, {"body.element": "smoothed"}, {"body.element": "hexahedral"}, {"body.volume": "patches"},
    {"body.material.law": "neo_hookean"}, {"body.element": "linear"},
])  # fmt: skip
@pytest.mark.parametrize("modulus", [4e4, 5e5])
def test_a_stiffener_is_the_body_with_another_modulus(beam, change, modulus):
    if change == {"body.volume": "patches"}:
        change = change | {"body.material.law": "neo_hookean", "body.element": "linear"}
    simulation = beam(jam(), change=change)
    result = hold(simulation, modulus)
    other = beam(change=change | {"body.materials.0.young_modulus": modulus}).step(Hold(1.0))
    np.testing.assert_allclose(result.state.positions, other.state.positions, atol=1e-8)


def test_the_inverse_finds_the_modulus_of_a_sag(beam):
    sagged = hold(beam(jam()), 2.5e5).effector_positions
    simulation = beam(jam(rate=2e5))
    repeat_step(simulation, Hold(1.0), 3)
    first = simulation.step(FollowTargets(sagged, 0.1))
    assert first.setpoints[0] == pytest.approx(1.2e5) and first.report.active_limits == ("jam.rate",)
    result = solved(simulation, FollowTargets(sagged, 0.1), 30)
    assert result.setpoints[0] == pytest.approx(2.5e5, rel=1e-3)
    far = sagged + [0.0, 0.0, 0.05]
    result = repeat_step(simulation, FollowTargets(far, 1.0), 30)
    assert result.setpoints[0] == pytest.approx(1e6, rel=1e-6)


def test_rows_and_stiffness_are_slopes(beam):
    simulation = beam(jam(), cells=(2, 1, 1), change={"body.material.law": "neo_hookean"})
    term, nodes = simulation.actuators.terms[0], simulation.model.nodes
    assert_slopes_of_actuators(term, nodes, np.array([3e4]), 5e-4, bar=1e-5)


def test_columns_name_a_stiffener(beam):
    header = RunColumns(beam(jam())).names
    assert header[header.index("jam_young_modulus_Pa") :][:2] == (
        "jam_young_modulus_Pa", "jam_strained_volume_m3")


@pytest.mark.parametrize("entry, change, key, why", [
    (jam(young_modulus=[0.0, 1.0]), {}, "stiffeners[0].young_modulus", "above zero"),
    (jam(young_modulus=[2e5, 3e5]), {}, "stiffeners[0].young_modulus", "100000, must lie within"),
    (jam(box=None), {}, "stiffeners[0]", "not the whole of one material"),
    (jam(box={"minimum": [-1] * 3, "maximum": [0.03, 1, 1]}), {}, "stiffeners[0]", "not the whole"),
    (jam(region="root"), {}, "stiffeners[0].box", "give one of both"),
    (jam(), {"body.material.law": "neo_hookean", "body.material.viscosity": [{"share": 0.1, "time": 1.0}]},
     "stiffeners[0]", "remembers"),
    (jam(body="bean"), {}, "stiffeners[0].body", "is beam meant"),
])  # fmt: skip
def test_a_stiffener_that_cannot_be_is_refused(beam, entry, change, key, why):
    with pytest.raises(SceneError) as refused:
        beam(entry, change=change)
    assert key in str(refused.value) and why in str(refused.value)


def test_two_stiffeners_of_one_region_are_refused(beam):
    with pytest.raises(SceneError, match="changes what jam does"):
        beam(jam(), jam(name="other"))
