"""Rest shapes of beams as actuators: curvature, twist and length, against closed forms."""

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import FollowTargets, Simulation
from softrobot_twin.tables.run_columns import RunColumns
from test.builder import builder
from test.finite_differences import assert_slopes_of_actuators
from test.scene_changes import built, hold, solved

LENGTH, E, THICKNESS, WIDTH = 0.2, 35e6, 0.005, 0.01
BENDING = E * WIDTH * THICKNESS**3 / 12.0
HINGE = {"at": "start", "to": "world", "by": "hinge", "axis": [0, 1, 0]}


@builder
def strip(*shapes, change=None, elements=8) -> Simulation:
    """Makes a strip along x, clamped at its start, whose thickness is along z."""
    mapping = {
        "name": "strip", "gravity": [0.0, 0.0, 0.0],
        "beams": [{
            "name": "leg", "points": [[0.0, 0.0, 0.0], [LENGTH, 0.0, 0.0]], "elements": elements,
            "section": {"rectangle": {"thickness": THICKNESS, "width": WIDTH}}, "fixed": ["start"],
            "thickness_direction": [0.0, 0.0, 1.0],
            "material": {"young_modulus": E, "poisson_ratio": 0.25, "density": 1000.0},
        }],
        "rest_shapes": [{"name": f"shape_{i}", "beam": "leg"} | one for i, one in enumerate(shapes)],
        "effectors": [{"name": "tip", "body": "leg", "points": [[LENGTH, 0.0, 0.0]]}],
        "solver": {"newton_iterations": 60, "residual_tolerance": 1e-9},
    }  # fmt: skip
    return built(mapping, change)


BEND, SIDEWAYS, TWIST, LONGER = {"bend": [-6, 6]}, {"bend_sideways": [-6, 6]}, {"twist": [-2, 2]}, {
    "elongation": [-0.1, 0.3]}  # fmt: skip


@pytest.mark.parametrize("angle", [-0.3, 1.0, 5.5])
def test_a_free_strip_takes_the_arc_of_its_rest_curvature(strip, angle):
    along, aside = LENGTH * np.sin(angle) / angle, LENGTH * (1.0 - np.cos(angle)) / angle
    tip = hold(strip(BEND), angle).effector_positions[0]
    np.testing.assert_allclose(tip, [along, 0.0, aside], atol=1e-9)
    tip = hold(strip(SIDEWAYS), angle).effector_positions[0]
    np.testing.assert_allclose(tip, [along, aside, 0.0], atol=1e-9)


def test_a_strip_grows_and_its_end_turns_without_load(strip):
    simulation = strip(LONGER, TWIST)
    result = hold(simulation, 0.15, 0.8)
    np.testing.assert_allclose(result.effector_positions[0], [LENGTH + 0.15, 0.0, 0.0], atol=1e-9)
    assert result.displacements[0] == pytest.approx(E * THICKNESS * WIDTH * 0.15 / LENGTH)
    strains = simulation.model.forces[0].deformations(result.state.positions)
    np.testing.assert_allclose(strains[:, 3], 0.1, atol=1e-9)


def test_a_blocked_strip_presses_by_the_moment_of_its_rest_curvature(strip):
    # Clamped at both ends it stays straight; a propped one needs 3/2 M / L at its tip.
    held = strip(BEND, change={"beams.0.fixed": ["start", "end"]})
    np.testing.assert_allclose(hold(held, 0.4).state.positions, held.model.nodes.rest_positions, atol=1e-9)
    propped = strip(BEND, change={"forces": [{
        "name": "prop", "body": "leg", "points": [[LENGTH, 0, 0]], "direction": [0, 0, 1],
        "control": "displacement"}]})  # fmt: skip
    result = hold(propped, 0.0, 0.02)
    assert result.efforts[0] == pytest.approx(-1.5 * BENDING * 0.02 / LENGTH**2, rel=5e-3)


def test_curvatures_follow_a_target_within_rates(strip):
    reached = strip(BEND, SIDEWAYS, LONGER)
    hold(reached, 0.8, 0.5, 0.02)
    target = reached.effector_positions()
    simulation = strip(BEND | {"rate": 1.0}, SIDEWAYS, LONGER)
    first = simulation.step(FollowTargets(target, 0.1))
    assert abs(first.setpoints[0]) <= 0.1 + 1e-12
    result = solved(simulation, FollowTargets(target, 0.1), 30)
    assert result.effector_errors[0] < 1e-4


@pytest.mark.parametrize("joined", [{}, {"beams.0.fixed": [], "beams.0.joined": [HINGE]}])
def test_rows_and_stiffness_are_slopes(strip, joined):
    simulation = strip(BEND, SIDEWAYS, TWIST, LONGER, elements=3, change=joined)
    term, nodes = simulation.actuators.terms[0], simulation.model.nodes
    assert_slopes_of_actuators(term, nodes, np.array([0.4, -0.3, 0.2, 0.01]), 1e-3, bar=1e-5)


def test_columns_name_a_rest_shape(strip):
    header = RunColumns(strip(BEND, LONGER)).names
    assert header[header.index("shape_0_rest_bend_rad") :][:2] == (
        "shape_0_rest_bend_rad", "shape_0_moment_Nm")
    assert "shape_1_rest_elongation_m" in header and "shape_1_force_N" in header


@pytest.mark.parametrize("shape, change, key, why", [
    ({"beam": "lag", **BEND}, {}, "rest_shapes[0].beam", "is leg meant"),
    (BEND | TWIST, {}, "rest_shapes[0]", "exactly one of"),
    ({"bend": [0.1, 0.2]}, {}, "rest_shapes[0].bend", "0, must lie within"),
    (BEND, {"beams.0.elements": 2}, "rest_shapes[0].bend", "more elements"),
    ({"elongation": [-0.19, 0.0]}, {}, "rest_shapes[0].elongation", "0.2 m long"),
    (BEND, {"beams.0.section": {"circle": {"radius": 0.005}}, "beams.0.thickness_direction": None},
     "rest_shapes[0].bend", "no thickness_direction"),
])  # fmt: skip
def test_a_rest_shape_that_cannot_be_is_refused(strip, shape, change, key, why):
    with pytest.raises(SceneError) as refused:
        strip(shape, change=change)
    assert key in str(refused.value) and why in str(refused.value)
