"""Derivatives of an equilibrium by numbers of its scene, against scenes that are solved again."""

from pathlib import Path

import numpy as np
import pytest

import yaml

from softrobot_twin.analysis import sensitivities
from softrobot_twin.analysis.sensitivities import Sensitivities, SensitivityError
from softrobot_twin.errors import CommandError
from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.scene.scene_parameters import changed_scene, parameters
from softrobot_twin.simulation import CommandSetpoints, Simulation
from test.places import CONFIG


BAR = 1.0e-6
# The tangent of a reduced body is the derivative of its forces within 2e-6.
REDUCED_BAR = 1.0e-5
# Half of the difference, as a share of a number; that of a length is a share of 1 cm.
SHARE = 1.0e-4


def settled(scene, setpoints=None, near=None):
    """A simulation in balance at some setpoints, or at changes of those at rest."""
    simulation = Simulation(scene, with_warnings=False)
    if near is None:
        setpoints = simulation.rest_setpoints + setpoints(simulation)
    else:
        simulation.take_over(near)
    for _ in range(80):
        before = simulation.state.positions
        simulation.step(CommandSetpoints(setpoints, 10.0))
        if np.abs(simulation.state.positions - before).max() < 1.0e-13:
            return simulation, setpoints
    raise AssertionError("does not come to rest")


def moved(simulation):
    """Every second actuator moved: cables are pulled by 3 mm, cavities get 500 Pa."""
    by_section = {"cables": -3.0e-3, "slides": 2.0e-3, "hinge_motors": 0.05, "cavities": 500.0}
    amounts = [by_section[kind.section] for kind in simulation.actuators.kinds]
    return np.where(np.arange(len(amounts)) % 2, 0.0, amounts)


def exact(name, changes=None):
    if name == "springy_sealed":
        path = CONFIG / "scenes" / "springy.yaml"
        mapping = yaml.safe_load(path.read_text())
        (cavity,) = mapping.pop("cavities")
        sealed = {"name": "air", "walls": cavity["walls"], "pressure": 700.0}
        scene = scene_from_mapping({**mapping, "sealed_cavities": [sealed]}, path)
        return scene.changed(solver={"residual_tolerance": 1.0e-11, "newton_iterations": 20})
    if name == "bar_of_a_box":
        scene = scene_from_mapping(yaml.safe_load(BAR_OF_A_BOX), Path("bar.yaml"))
        return scene.changed(solver={"residual_tolerance": 1.0e-11, "newton_iterations": 20})
    name = name.removesuffix("_held")
    scene = load_scene(CONFIG / "scenes" / f"{name}.yaml", changes or {})
    return scene.changed(solver={"residual_tolerance": 1.0e-11, "newton_iterations": 20})


BAR_OF_A_BOX = """
name: bar
body:
  mesh: {box: {size: [0.1003, 0.02, 0.012], cells: [8, 2, 2]}, translation: [0.0, -0.01, -0.006]}
  element: quadratic
  material: {young_modulus: 5.0e5, poisson_ratio: 0.4, density: 1000.0}
  fixed: [{box: {minimum: [-0.001, -1.0, -1.0], maximum: [0.001, 1.0, 1.0]}}]
cables:
  - name: upper
    pull_point: [0.0, 0.001, 0.0047]
    hold_radius: 0.003
    points: [[0.0313, 0.001, 0.0047], [0.0612, 0.001, 0.0045], [0.0931, 0.001, 0.0041]]
effectors: [{name: tip, points: [[0.0991, 0.0023, 0.0011]]}]
"""

CASES = [
    ("finger", "body.material.young_modulus"), ("finger", "body.material.poisson_ratio"),
    ("finger", "body.material.density"), ("finger", "cables.flexor.points[1][2]"),
    ("segment", "fibres[0].stiffness"), ("segment", "gravity[2]"),
    ("flexo", "beams[0].material.young_modulus"), ("strider", "beams[0].material.young_modulus"),
    ("strider", "gravity[2]"), ("diamond_reduced", "gravity[2]"),
    ("trunk", "cables[0].points[3][1]"), ("finger_held", "cables.flexor.points[1][2]"),
    ("finger_held", "cables.flexor.hold_radius"), ("stifface", "cables[0].points[0][0]"),
    ("bar_of_a_box", "body.mesh.box.size[2]"), ("bar_of_a_box", "body.mesh.box.size[0]"),
    ("springy_sealed", "sealed_cavities[0].pressure"), ("bar_of_a_box", "body.mesh.translation[2]"), ("bar_of_a_box", "cables[0].pull_point[2]"),
    ("emio", "beams[0].material.young_modulus"), ("emio", "mounting[0].bodies[0].translation[0]"),
    ("emio", "mounting[0].actuators[1].displacement"), ("emio", "beams[0].joined[1].through[2]"),
]  # fmt: skip


@pytest.mark.sampled
@pytest.mark.parametrize(("name", "key"), CASES)
def test_derivatives_are_those_of_states_that_are_solved_again(name, key):
    is_single = name == "finger" and ".points" in key
    scene = exact(name, {"cables[0].hold_radius": 0.0} if is_single else None)
    simulation, setpoints = settled(scene, moved)
    (parameter,) = parameters(scene, key)
    found = Sensitivities(simulation).of_parameters([parameter])
    value = parameter.read(scene)
    # The weights within a radius bend on a shorter way.
    share = 0.1 * SHARE if any(cable.hold_radius for cable in scene.cables) else SHARE
    step = share * (max(abs(value), 0.01) if parameter.unit == "m" else abs(value))
    ends = [settled(parameter.set(scene, value + side * step), setpoints, simulation)[0]
            for side in (1, -1)]  # fmt: skip
    places, efforts = (
        (getter(ends[0]) - getter(ends[1])) / (2.0 * step)
        for getter in (Simulation.effector_positions, lambda one: one.state.efforts)
    )
    bar = REDUCED_BAR if simulation.has_reduced_bodies else BAR
    assert np.abs(found.effectors[..., 0] - places).max() < bar * np.abs(places).max()
    assert (np.abs(found.efforts[:, 0] - efforts) <= bar * np.abs(efforts).max(initial=0.0)).all()


@pytest.fixture(scope="module")
def finger():
    return settled(exact("finger", {f"cables[{i}].hold_radius": 0.0 for i in (0, 1)}), moved)[0]


def test_the_adjoint_gives_the_same_derivatives(finger):
    own = Sensitivities(finger)
    chosen = parameters(finger.scene, "body.material", "gravity", "cables.flexor.points[2]")
    found, adjoint = own.of_parameters(chosen), own.adjoint()
    for index, one in enumerate(chosen):
        loads = own.loads(one)
        by_adjoint = np.einsum("nkr,nk->r", adjoint.forces, loads.forces)
        by_adjoint += adjoint.displacements.T @ loads.displacements + loads.effectors.ravel()
        expected = found.effectors[..., index].ravel()
        # Terms of up to 15 m cancel, which leaves their round-off.
        round_off = 1e-15 * np.einsum("nkr,nk->r", np.abs(adjoint.forces), np.abs(loads.forces)).max()
        atol = max(1e-12 * np.abs(expected).max(), round_off)
        np.testing.assert_allclose(by_adjoint, expected, rtol=1e-9, atol=atol)


def test_the_gradient_of_a_function_is_by_the_adjoint_what_all_derivatives_give(finger, drawn_rng):
    own, chosen = Sensitivities(finger), parameters(finger.scene, "body.material", "cables.flexor.points[2]")
    by_place, by_effort = drawn_rng.normal(size=(1, 3)), drawn_rng.normal(size=2)
    for holds in (True, False, np.array([True, False])):
        found = own.of_parameters(chosen, holds)
        expected = np.einsum("ek,ekp->p", by_place, found.effectors) + by_effort @ found.efforts
        gradient = own.gradient(chosen, by_place, by_effort, holds)
        np.testing.assert_allclose(gradient, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_a_cable_changes_nothing_but_the_terms_of_actuators(finger, monkeypatch):
    own, chosen = Sensitivities(finger), parameters(finger.scene, "cables.flexor.points")
    own.of_parameters(parameters(finger.scene, "gravity"))
    monkeypatch.setattr(sensitivities, "build_terms", None)
    assert own.of_parameters(chosen).effectors.shape == (1, 3, len(chosen))


def test_a_mesh_of_another_structure_has_no_derivative():
    text = BAR_OF_A_BOX.replace("cells: [8, 2, 2]", "cell_size: 0.01003")
    other = Simulation(scene_from_mapping(yaml.safe_load(text), Path("bar.yaml")), with_warnings=False)
    with pytest.raises(SensitivityError, match="makes another mesh"):
        Sensitivities(other).of_parameters(parameters(other.scene, "body.mesh.box.size[0]"))


def test_the_answer_to_a_force_is_the_apparent_compliance(finger):
    own = Sensitivities(finger)
    rows = own.adjoint().forces  # effectors by forces on nodes; at the tip the compliance
    answer = own.solve_sensitivity(rows).moves.reshape(-1, rows.shape[2])
    symmetric = rows.reshape(-1, rows.shape[2]).T @ answer
    np.testing.assert_allclose(symmetric, symmetric.T, rtol=1e-8, atol=1e-12 * np.abs(symmetric).max())


def test_held_shortenings_and_held_lengths_differ_by_the_length_at_rest(finger):
    own = Sensitivities(finger)
    (point,) = parameters(finger.scene, "cables.flexor.points[1][2]")
    by_length, by_shortening = (own.loads(point, held) for held in (True, False))
    step, lengths = 1.0e-6, []
    for side in (1, -1):
        other = point.set(finger.scene, point.read(finger.scene) + side * step)
        lengths.append(Simulation(other, with_warnings=False).rest_setpoints[0])
    slope = (lengths[0] - lengths[1]) / (2.0 * step)
    difference = by_length.displacements - by_shortening.displacements
    np.testing.assert_allclose(difference, [slope, 0.0], rtol=1e-6, atol=1e-9)


def test_a_state_out_of_balance_has_no_derivatives():
    simulation = Simulation(exact("finger"), with_warnings=False)
    chosen = parameters(simulation.scene, "body.material.young_modulus")
    with pytest.raises(SensitivityError, match="state: is not in balance: .* settle first"):
        Sensitivities(simulation).of_parameters(chosen)
    for odd in ([True] * 3, "no", 0.5):
        with pytest.raises(CommandError, match="holds_setpoints: .* of all actuators or of each of 2"):
            Sensitivities(simulation).of_parameters(chosen, odd)


def test_the_material_of_a_reduced_body_has_no_derivative():
    simulation = Simulation(exact("diamond_reduced"), with_warnings=False)
    with pytest.raises(SensitivityError, match="young_modulus: cannot be changed"):
        Sensitivities(simulation).of_parameters(
            parameters(simulation.scene, "body.material.young_modulus"))


def test_no_parameters_have_no_derivatives(finger):
    found = Sensitivities(finger).of_parameters([])
    assert found.effectors.shape == (1, 3, 0)


def test_a_state_restores_into_a_scene_with_other_numbers(finger):
    other = changed_scene(finger.scene, {"body.material.young_modulus": 4e5})
    softer = Simulation(other, with_warnings=False)
    softer.restore(finger.state)
    assert np.array_equal(softer.state.positions, finger.state.positions)


def test_a_scene_without_effectors_has_derivatives_of_efforts(finger):
    alone = Simulation(finger.scene.changed(effectors=()), with_warnings=False)
    alone.restore(finger.state)
    chosen = parameters(finger.scene, "body.material.young_modulus")
    own, whole = (Sensitivities(one).of_parameters(chosen) for one in (alone, finger))
    assert own.effectors.shape == (0, 3, 1)
    np.testing.assert_allclose(own.efforts, whole.efforts, rtol=1e-9)


def test_nodes_that_rest_elsewhere_keep_their_displacements():
    simulation = settled(exact("bar_of_a_box"), moved)[0]
    (size,) = parameters(simulation.scene, "body.mesh.box.size[0]")
    longer = Simulation(size.set(simulation.scene, 0.11), with_warnings=False)
    longer.take_over(simulation)
    before, after = (one.state.positions - one.model.nodes.rest_positions for one in (simulation, longer))
    np.testing.assert_allclose(after, before, rtol=0, atol=1e-15)
    assert longer.state.positions[:, 0].max() > 0.105
