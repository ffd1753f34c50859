"""The orthotropic law: slopes, closed forms in three directions, and what is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.laws.orthotropic import of_constants
from softrobot_twin.mechanics.point_law import law_of
from softrobot_twin.simulation import CommandEfforts, Simulation
from test.builder import builder
from test.scene_changes import built, solved

MODULI, SHEARS, RATIOS = (3e6, 1e6, 2e6), (0.6e6, 0.9e6, 0.4e6), (0.3, 0.25, 0.2)
CONSTANTS = {"young_moduli": MODULI, "shear_moduli": SHEARS, "poisson_ratios": RATIOS,
             "first_axis": (1.0, 0.0, 0.0), "second_axis": (0.0, 1.0, 0.0)}  # fmt: skip
TURNED = {"first_axis": (1.0, 2.0, -1.0), "second_axis": (1.0, 0.0, 1.0)}
SIDE = 0.02


def at(matrix):
    return tuple(map(tuple, matrix))


def kernels(parameters):
    """Ψ and P of a law, and dP, as functions of arrays."""
    law = law_of(parameters)

    def change(F, dF):
        rows = law.linearize(parameters, at(F), True, False)
        return np.array(law.differential(parameters, rows, at(dF)))

    return (lambda F: law.energy_density(parameters, at(F)),
            lambda F: np.array(law.stress(parameters, at(F))), change)  # fmt: skip


def test_stress_and_differential_are_slopes_and_turning_stores_nothing(drawn_rng):
    energy, stress, change = kernels(of_constants(CONSTANTS | TURNED, 0.0))
    turn = Rotation.random(random_state=5).as_matrix()
    assert energy(turn) == pytest.approx(0.0, abs=1e-9)
    F, dF = np.eye(3) + 0.3 * drawn_rng.uniform(-1, 1, (3, 3)), drawn_rng.uniform(-1, 1, (3, 3))
    assert energy(turn @ F) == pytest.approx(energy(F), rel=1e-12)
    h = 1e-6
    slope = (energy(F + h * dF) - energy(F - h * dF)) / (2.0 * h)
    assert np.sum(stress(F) * dF) == pytest.approx(slope, rel=1e-6, abs=1e-2)
    slopes = (stress(F + h * dF) - stress(F - h * dF)) / (2.0 * h)
    np.testing.assert_allclose(change(F, dF), slopes, rtol=1e-6, atol=1e-6 * np.abs(slopes).max())


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_each_axis_stretches_by_its_modulus_narrows_by_its_ratios_and_shears_by_its_own(axis):
    stress, small = kernels(of_constants(CONSTANTS | TURNED, 0.0))[1], 1e-6
    first, second = (np.array(TURNED[key]) / np.linalg.norm(TURNED[key]) for key in TURNED)
    axes = np.array([first, second, np.cross(first, second)])
    ratios = np.array([[-1.0, 0.3, 0.25], [0.1, -1.0, 0.2], [0.25 * 2 / 3, 0.4, -1.0]])
    strain = -small * np.diag(ratios[axis])
    P = axes @ stress(np.eye(3) + axes.T @ strain @ axes) @ axes.T
    expected = np.zeros((3, 3))
    expected[axis, axis] = MODULI[axis] * small
    np.testing.assert_allclose(P, expected, atol=1e-5 * MODULI[axis] * small)
    i, j = ((0, 1), (0, 2), (1, 2))[axis]
    shear = np.zeros((3, 3))
    shear[i, j] = small
    P = axes @ stress(np.eye(3) + axes.T @ shear @ axes) @ axes.T
    assert P[i, j] == pytest.approx(SHEARS[axis] * small, rel=1e-4)


@builder
def bar(change=None, **constants) -> Simulation:
    """Makes a bar along x that a force pulls at its end, or whatever a turn of its mesh makes of x."""
    mapping = {
        "name": "bar", "gravity": [0.0, 0.0, 0.0],
        "body": {
            "name": "bar", "mesh": {"box": {"size": [10 * SIDE, SIDE, SIDE], "cells": [10, 1, 1]}},
            "material": {"law": "orthotropic", "constants": CONSTANTS | constants, "density": 1000.0},
            "fixed": [{"frame": "mesh", "box": {"minimum": [-1, -1, -1], "maximum": [1e-6, 1, 1]}}],
        },
        "forces": [{"name": "pull", "points": [[10 * SIDE, SIDE / 2, SIDE / 2]], "direction": [1, 0, 0]}],
        "effectors": [{"name": "a", "points": [[0, 0, 0]]}, {"name": "b", "points": [[0, 0, 0]]}],
        "solver": {"newton_iterations": 40, "residual_tolerance": 1e-9},
    }  # fmt: skip
    return built(mapping, change)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.4, -0.7, 1.1)])
@pytest.mark.parametrize("axes, modulus", [
    ([1, 0, 0, 0, 1, 0], MODULI[0]), ([0, 1, 0, 1, 0, 0], MODULI[1]), ([0, 1, 0, 0, 0, 1], MODULI[2]),
])  # fmt: skip
def test_a_bar_stretches_by_the_modulus_along_it_however_it_is_turned(bar, axes, modulus, turn):
    R = Rotation.from_euler("xyz", turn).as_matrix()
    end = [(R @ [10 * SIDE, y, z]).tolist() for y in (0, SIDE) for z in (0, SIDE)]
    simulation = bar(
        first_axis=axes[:3], second_axis=axes[3:], poisson_ratios=[0.0] * 3,
        change={"body.mesh.rotation": list(turn), "forces.0.direction": R[:, 0].tolist(),
                "forces.0.points": end, **{
                    f"effectors.{k}.points": [(R @ [x * SIDE, SIDE / 2, SIDE / 2]).tolist()]
                    for k, x in enumerate((3.0, 7.0))}},
    )  # fmt: skip
    before = simulation.effector_positions()
    force = 1e-3 * modulus * SIDE**2
    result = solved(simulation, CommandEfforts(np.array([force]), 1.0))
    longer = np.diff(result.effector_positions - before, axis=0)[0] @ R[:, 0]
    assert longer == pytest.approx(1e-3 * 4 * SIDE, rel=0.01)


@pytest.mark.parametrize("constants, change, why", [
    ({"poisson_ratios": [0.3, 2.0, 0.2]}, {}, "too large"), ({"shear_moduli": [1e5, 0.0, 1e5]}, {}, "above 0"),
    ({"second_axis": [1, 1, 0]}, {}, "right angles"), ({"young_moduli": [1e5]}, {}, "three numbers"),
    ({}, {"body.material.poisson_ratio": 0.3}, "has it among its constants"),
    ({}, {"body.material.young_modulus": 1e5}, "not young_modulus"),
])  # fmt: skip
def test_constants_that_are_no_material_are_refused(bar, constants, change, why):
    with pytest.raises(SceneError, match=why):
        bar(change=change, **constants)
