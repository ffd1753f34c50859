"""Facts of the error of a mesh: the estimate against what finer meshes tell.

``pytest -s test/simulation/test_mesh_error.py`` prints the tables.
"""

import copy
from typing import NamedTuple

import numpy as np
import pytest

from softrobot_twin.analysis.mesh_error import (
    ActuatorLoads,
    MeshErrorEstimator,
    MeshErrorUnknown,
    load_errors,
)
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Hold, Simulation
from test.builder import builder
from test.scene_changes import repeat_step, solved

FACTOR = 1.5
"""An estimate is trusted when it is within this factor of the true error."""
LENGTH, WIDTH, YOUNG, DENSITY = 0.1, 0.02, 1.8e6, 1070.0


def discretization_error(simulation, forces_given=False):
    """Error of the effectors by the mesh at the state of a simulation [m]."""
    return MeshErrorEstimator(simulation.scene).at(ActuatorLoads.of(simulation, forces_given))


class Row(NamedTuple):
    mesh: str
    element: str
    load: str
    true: float
    estimated: float

    @property
    def factor(self) -> float:
        return max(self.true / self.estimated, self.estimated / self.true)


def compared(family: dict, finest) -> list[Row]:
    """Errors estimated on each mesh by itself, beside those against the finest mesh.

    Args:
        family: Scenes by the names of their meshes.
        finest: The scene on a mesh fine enough to know the truth.
    """
    truth = MeshErrorEstimator(finest).responses()[2]
    names = tuple(cable.name for cable in finest.cables)
    rows = []
    for mesh, scene in family.items():
        own, quadratic, best = MeshErrorEstimator(scene).responses()
        for element, response in (("linear", own), ("quadratic", quadratic)):
            pairs = zip(load_errors(response, truth, names), load_errors(response, best, names),
                        strict=True)
            for true, told in pairs:
                rows.append(Row(mesh, element, f"{true.load}, force", true.forces, told.forces))
                if true.lengths == true.lengths:
                    rows.append(
                        Row(mesh, element, f"{true.load}, length", true.lengths, told.lengths)
                    )
    print("\n" + "\n".join(
        f"{row.mesh:>12} {row.element:>9} {row.load:>14}  true {100 * row.true:6.2f} %  "
        f"estimated {100 * row.estimated:6.2f} %  factor {row.factor:.2f}" for row in rows))
    return rows


@builder
def bar(write_block, /, cells, poisson_ratio=0.45, element="linear"):
    """Makes the scene of a cantilever with one cable along its upper side."""
    file = write_block((LENGTH, WIDTH, WIDTH), cells, name="bar_" + "x".join(map(str, cells)))
    mapping = {
        "name": "bar", "gravity": [0.0, 0.0, -9.81],
        "body": {
            "mesh": {"file": file, "translation": [LENGTH / 2, WIDTH / 2, WIDTH / 2]},
            "element": element,
            "material": {"young_modulus": YOUNG, "poisson_ratio": poisson_ratio,
                         "density": DENSITY},
            "fixed": [{"box": {"minimum": [-1e-6, -1, -1], "maximum": [1e-6, 1, 1]}}],
        },
        "cables": [{
            "name": "upper", "pull_point": [-0.02, WIDTH / 2, WIDTH],
            "points": [[0.95 * LENGTH, WIDTH / 2, WIDTH]], "hold_radius": WIDTH / 4,
            "shortening": [0.0, 0.02], "tension": [0.0, 10.0],
        }],
        "effectors": [{"name": "tip", "points": [[LENGTH, WIDTH / 2, WIDTH / 2]]}],
        "solver": {"newton_iterations": 30, "residual_tolerance": 1e-8},
    }  # fmt: skip
    return scene_from_mapping(mapping)


@builder
def diamond_on(diamond, /, number):
    """Makes the scene of the Diamond on one of its meshes, with one cable."""
    mapping = copy.deepcopy(diamond().scene.model_dump(mode="json"))
    mapping["body"]["mesh"]["file"] = f"../../meshes/diamond_{number}.vtk"
    mapping["cables"] = mapping["cables"][:1]
    return scene_from_mapping(mapping, diamond().scene.path)


@pytest.mark.exhaustive
def test_on_the_meshes_of_the_diamond_the_estimate_is_within_a_factor_of_the_truth(diamond_on):
    family = {str(number): diamond_on(number) for number in (150, 200, 400)}
    rows = compared(family, diamond_on(1600))
    assert len(rows) == 3 * 2 * 3
    assert max(row.factor for row in rows) < FACTOR


@pytest.mark.exhaustive
@pytest.mark.parametrize("poisson_ratio", [
    pytest.param(0.3, marks=pytest.mark.exhaustive), 0.45, pytest.param(0.49, marks=pytest.mark.exhaustive)])
def test_on_bars_the_estimate_is_within_a_factor_of_the_truth(bar, poisson_ratio):
    family = {
        "x".join(map(str, cells)): bar(cells, poisson_ratio)
        for cells in ((6, 2, 2), (12, 3, 3))
    }
    rows = compared(family, bar((18, 5, 5), poisson_ratio))
    assert len(rows) == 2 * 2 * 3
    assert max(row.factor for row in rows) < FACTOR


@pytest.mark.exhaustive
def test_the_live_estimate_of_a_hanging_bar_is_right_for_both_elements(bar):
    """The truth is what quadratic elements give on a mesh of a third the size."""

    def sag(scene):
        simulation = Simulation(scene)
        rest = simulation.effector_positions()[0, 2]
        repeat_step(simulation, Hold(), 3)
        return rest - simulation.effector_positions()[0, 2], simulation

    def without_cable(*arguments):
        return bar(*arguments).model_copy(update={"cables": ()})

    fine, _ = sag(without_cable((24, 6, 6), 0.45, "quadratic"))
    for element in ("linear", "quadratic"):
        coarse, simulation = sag(without_cable((8, 2, 2), 0.45, element))
        assert discretization_error(simulation) == pytest.approx(fine - coarse, rel=0.33)


@pytest.mark.exhaustive
def test_the_live_estimate_of_a_bent_diamond_is_within_a_factor_of_the_truth(diamond_on):
    def bent(number, element):
        scene = diamond_on(number)
        body = scene.body.model_copy(update={"element": element})
        cable = scene.cables[0].model_copy(update={"hold_radius": 0.004, "rate": None})
        solver = scene.solver.model_copy(update={"newton_iterations": 30})
        simulation = Simulation(scene.model_copy(
            update={"body": body, "cables": (cable,), "solver": solver}
        ))
        for share in (0.25, 0.5, 0.75, 1.0):
            simulation.step(CommandSetpoints(simulation.rest_setpoints - share * 0.012, 1.0))
        return simulation

    simulation = bent(400, "linear")
    truth = bent(600, "quadratic").effector_positions()
    error = np.linalg.norm(simulation.effector_positions() - truth)
    told = discretization_error(simulation)
    assert error / FACTOR < told < FACTOR * error


def test_prescribed_forces_have_larger_errors_than_prescribed_lengths(diamond_on):
    simulation = Simulation(diamond_on(150))
    simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.004, 1.0))
    lengths, forces = (discretization_error(simulation, given) for given in (False, True))
    assert 0.0 < lengths < forces


def test_the_estimate_does_not_change_the_simulation(diamond):
    first, second = diamond(), diamond()
    for simulation in (first, second):
        simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.003, 0.1))
    discretization_error(first)
    for simulation in (first, second):
        simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.004, 0.1))
    np.testing.assert_array_equal(first.state.positions, second.state.positions)


def test_it_predicts_error_and_time_of_quadratic_elements(bar):
    told = MeshErrorEstimator(bar((12, 3, 3))).at_rest()
    assert told.is_large and told.own.element == "linear"
    assert 5.0 * told.quadratic.forces < told.own.forces
    assert "quadratic elements: " in told.in_words() and "ms a step" in told.in_words()
    better = MeshErrorEstimator(bar((12, 3, 3), element="quadratic")).at_rest()
    assert not better.is_large and better.own is better.quadratic
    assert better.own.forces == pytest.approx(told.quadratic.forces)


def test_a_load_that_does_not_move_the_effectors_has_no_estimate(bar):
    """A cable from the side bends the bar in the plane that its weight does not."""

    def sideways(directions):
        scene = bar((6, 2, 2))
        side = scene.cables[0].model_copy(update={
            "name": "side", "pull_point": (0.09, -0.05, WIDTH / 2),
            "points": ((0.09, 0.0, WIDTH / 2),)})
        tip = scene.effectors[0].model_copy(update={"directions": directions})
        scene = scene.model_copy(update={"cables": (side,), "effectors": (tip,)})
        return {load.load for load in MeshErrorEstimator(scene).at_rest().own.loads}

    assert sideways(("y", "z")) == {"gravity", "side"}
    assert sideways(("z",)) == {"gravity"}
    assert sideways(("y",)) == {"side"}


def test_without_effectors_there_is_no_estimate(diamond):
    simulation = diamond(lambda m: m.pop("effectors"))
    with pytest.raises(MeshErrorUnknown, match="no effector"):
        MeshErrorEstimator(simulation.scene)


def test_a_law_without_a_cubic_correction_has_no_estimate(diamond):
    scene = diamond().scene
    material = scene.body.material.model_copy(update={"law": "rubber"})
    body = scene.body.model_copy(update={"material": material})
    with pytest.raises(MeshErrorUnknown, match="rubber has no cubic correction"):
        MeshErrorEstimator(scene.model_copy(update={"body": body}))


def test_an_unheld_body_has_no_estimate(bar):
    loose = bar((6, 1, 1)).model_dump(mode="json")
    loose["body"]["fixed"], loose["integration"], loose["cables"] = [], "dynamic", []
    with pytest.raises(MeshErrorUnknown, match="not held"):
        MeshErrorEstimator(scene_from_mapping(loose))


def test_a_state_in_contact_has_no_estimate(beam, rod):
    simulation = beam(rod)
    estimator = MeshErrorEstimator(simulation.scene)
    assert estimator.at_rest().own.forces > 0.0
    with pytest.raises(MeshErrorUnknown, match="touch"):
        estimator.at(ActuatorLoads.of(simulation, False))


def test_a_state_with_every_cable_twice_has_the_error_of_one_with_each_once(diamond):
    """W of the cables is singular then."""

    def twice(mapping):
        mapping["cables"] += [cable | {"name": f"{cable['name']}_2"} for cable in mapping["cables"]]

    errors = []
    for change, count in ((lambda mapping: None, 1), (twice, 2)):
        simulation = diamond(change)
        wound = np.tile([0.006, 0.003, 0.0, 0.0], count)
        simulation.step(CommandSetpoints(simulation.rest_setpoints - wound, 1.0))
        errors.append(discretization_error(simulation))
    assert errors[0] > 0.0 and errors[1] == pytest.approx(errors[0], rel=1e-3)


def test_without_load_or_motion_the_state_has_no_error(diamond):
    simulation = diamond(lambda m: m.update(gravity=[0.0, 0.0, 0.0]))
    assert discretization_error(simulation) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("element, told", [("linear", True), ("quadratic", False)])
def test_linear_elements_near_incompressibility_are_warned_of(bar, element, told):
    notes = Simulation(bar((6, 1, 1), 0.485, element)).notes
    assert any("poisson_ratio = 0.485" in note and "lock" in note for note in notes) == told


@builder
def inflated_column(simulate, hollow, /, fineness: int, control: str = "volume"):
    """Makes the scene of a hollow column, of cells whose edges are this share of a fourth."""
    cells = tuple(fineness * count for count in (4, 4, 6))
    hole = tuple((fineness * low, fineness * high) for low, high in ((1, 3), (2, 3), (1, 5)))
    body, surface = hollow(cells=cells, hole=hole, name=f"column_{fineness}")
    cavity = {"name": "air", "walls": [{"file": surface}], "control": control}
    return simulate(
        body=body, cavities=[cavity],
        effectors=[{"name": "tip", "points": [[0.01, 0.01, 0.06]]}],
    )  # fmt: skip


@pytest.mark.exhaustive
def test_the_error_at_given_pressures_and_volumes_is_near_that_against_a_finer_mesh(inflated_column):
    def relative(found, exact):
        return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))

    _, _, best = MeshErrorEstimator(inflated_column(2).scene).responses()
    own, quadratic, limit = MeshErrorEstimator(inflated_column(1).scene).responses()
    for coarse in (own, quadratic):
        for quantity in ("W_ea", "W_aa"):
            estimated = relative(getattr(coarse, quantity), getattr(limit, quantity))
            true = relative(getattr(coarse, quantity), getattr(best, quantity))
            assert true / 2.0 < estimated < 2.0 * true, (quantity, estimated, true)
    told = MeshErrorEstimator(inflated_column(1).scene).at_rest()
    assert "at given forces and pressures and" in told.in_words()
    assert "at given volumes" in told.in_words()
    assert [load.load for load in told.own.loads][-1] == "air"


@pytest.mark.sampled
@pytest.mark.parametrize("control", ["pressure", "volume"])
def test_the_error_of_an_inflated_state_is_estimated(inflated_column, control):
    simulation = inflated_column(1, control)
    asked = 2.0e3 if control == "pressure" else 1.05 * simulation.rest_setpoints[0]
    solved(simulation, CommandSetpoints([asked], 1.0), 3)
    kept = discretization_error(simulation)
    by_pressure = discretization_error(simulation, forces_given=True)
    assert 1e-5 < by_pressure < 5e-3
    if control == "pressure":
        assert kept == pytest.approx(by_pressure, rel=1e-2)
    else:
        assert kept > 0.0 and abs(kept - by_pressure) > 0.01 * by_pressure


@pytest.mark.parametrize("asks", [
    {"orientation": {"points": [[0.1, 0, 0], [0.1, 0.02, 0], [0.1, 0, 0.02]]}, "directions": []},
    {"stiffness": {"weight": 0.5}},
], ids=["orientation", "stiffness"])  # fmt: skip
def test_of_effectors_that_ask_for_more_than_a_place_the_place_is_judged(bar, asks):
    scene = bar((10, 2, 2))
    effector = {**scene.model_dump(mode="json")["effectors"][0], **asks}
    other = scene_from_mapping({**scene.model_dump(mode="json"), "effectors": [effector]})
    errors = []
    for each in (scene, other):
        simulation = Simulation(each)
        simulation.step(CommandSetpoints(simulation.rest_setpoints - 0.002, 10.0))
        errors.append(discretization_error(simulation))
    assert errors[1] == pytest.approx(errors[0], rel=1e-6) and errors[0] > 0.0
