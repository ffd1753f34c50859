"""The full model tells the error of a reduced body, also of what the basis cannot see."""

import copy

import numpy as np
import pytest
import yaml

from softrobot_twin.analysis.reduction_error import FullModelError, ReductionStates
from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.scene.scene_changes import without_reductions
from softrobot_twin.scene.schema import Touch
from softrobot_twin.simulation import CommandSetpoints, Simulation, State
from softrobot_twin.simulation.effects.touches import Touched
from test.scene_changes import repeat_step

ANY_TIME = 1.0e3
TRAINED = 0.011
FINGER = [0.2, -0.1, 0.15]


@pytest.fixture(scope="module")
def judge(half_trained):
    """Full and reduced simulation with a touch at the tip, exact and without rates; their judge."""
    scene = load_scene(half_trained)
    cables = tuple(cable.model_copy(update={"rate": None}) for cable in scene.cables)
    solver = scene.solver.model_copy(update={"newton_iterations": 30, "residual_tolerance": 1.0e-8})
    touch = Touch(name="finger", points=scene.effectors[0].points, while_touched="follow_targets")
    scene = scene.model_copy(update={"cables": cables, "solver": solver, "touches": (touch,)})
    reduced = Simulation(scene, with_warnings=False)
    full = Simulation(without_reductions(scene), with_warnings=False)
    return full, reduced, FullModelError(reduced)


def wound(simulation, shortening, force=(0.0, 0.0, 0.0)):
    """The tip in the equilibrium at shortenings of the cables [m] under a force at it [N]."""
    simulation.reset()
    touched = Touched(np.array([force], float), np.full((1, 3), np.nan))
    for share in (0.2, 0.4, 0.6, 0.8, 1.0, 1.0, 1.0):
        lengths = simulation.rest_setpoints - share * shortening
        result = simulation.step(CommandSetpoints(lengths, ANY_TIME), measured=touched)
    assert result.report.residual < 1.0e-5
    return result.effector_positions[0]


@pytest.mark.parametrize("force", [[0.0, 0.0, 0.0], FINGER], ids=["free", "touched"])
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_the_full_model_tells_the_error_within_a_tenth(judge, factor, force):
    full, reduced, errors = judge
    rest = reduced.model.effectors.positions(reduced.model.nodes.rest_positions)
    rng, ratios, by_spare_modes, states = np.random.default_rng(2), [], [], ReductionStates(reduced)
    for _ in range(6):
        shortening = factor * TRAINED * rng.random(4)
        shortening[rng.integers(4)] = factor * TRAINED
        true = np.linalg.norm(wound(full, shortening, force) - wound(reduced, shortening, force))
        found = errors.errors(reduced.state)["body"]
        ratios.append(found.distance / true)
        moved = np.linalg.norm(reduced.effector_positions() - rest)
        assert found.share == pytest.approx(found.distance / moved)
        by_spare_modes.append(states.read()["body"].error / true)
        assert 2 <= errors.linearizations <= 4
    np.testing.assert_allclose(ratios, 1.0, atol=0.1)
    if any(force):
        # No state of the training had a load there: spare modes tell a fifth of the error.
        assert np.median(by_spare_modes) < 0.5


def test_the_nodes_of_the_full_model_are_where_the_coordinates_place_them(judge):
    full, reduced, errors = judge
    wound(reduced, np.array([0.004, 0.0, 0.002, 0.008]))
    lifted = errors.lifted(reduced.state)
    assert isinstance(lifted, State)
    assert lifted.positions.shape == full.state.positions.shape
    errors.better.restore(lifted)
    for name in ("effector_positions", "marker_positions", "surface_positions"):
        np.testing.assert_allclose(
            getattr(errors.better, name)(), getattr(reduced, name)(), atol=1e-12, err_msg=name
        )
    np.testing.assert_array_equal(lifted.efforts, reduced.state.efforts)
    np.testing.assert_array_equal(lifted.setpoints, reduced.state.setpoints)


def test_judging_leaves_the_reduced_simulation_as_it_was(judge):
    _, reduced, errors = judge
    wound(reduced, np.array([0.004, 0.0, 0.002, 0.008]))
    before = reduced.state
    errors.errors(before)
    assert reduced.state is before


@pytest.mark.parametrize("first", ["body", "beside"])
def test_bodies_beside_a_reduced_one_keep_their_nodes(half_trained, first):
    mapping = yaml.safe_load(half_trained.read_text())
    body = {"name": "body", **mapping.pop("body")}
    beside = copy.deepcopy(body)
    beside.pop("reduced")
    beside.update(name="beside")
    beside["mesh"]["translation"] = [0.5, 0.0, 0.0]
    beside["fixed"][0]["frame"] = "mesh"
    mapping["bodies"] = [body, beside] if first == "body" else [beside, body]
    mapping.pop("markers")
    for entry in (*mapping["cables"], *mapping["effectors"]):
        entry["body"] = "body"
    mapping["effectors"][0].pop("measured_by")
    mapping["effectors"].append({"name": "other", "body": "beside", "points": [[0.5, 0.0, 0.125]]})
    simulation = Simulation(scene_from_mapping(mapping, half_trained), with_warnings=False)
    lengths = simulation.rest_setpoints - [0.006, 0.0, 0.002, 0.008]
    repeat_step(simulation, CommandSetpoints(lengths, ANY_TIME), 12)
    places, surface = simulation.effector_positions(), simulation.surface_positions()
    judge = FullModelError(simulation)
    judge.better.restore(judge.lifted(simulation.state))
    np.testing.assert_allclose(judge.better.effector_positions(), places, atol=1e-12)
    np.testing.assert_allclose(judge.better.surface_positions(), surface, atol=1e-12)
    # Errors are those of the effectors on the reduced body.
    assert list(judge.errors(simulation.state)) == ["body"]
    found = ReductionStates(simulation).read()
    assert list(found) == ["body"] and 0.0 < found["body"].error < 1.0e-3


def test_in_contact_the_full_model_tells_the_error_too(half_trained):
    mapping = yaml.safe_load(half_trained.read_text())
    mapping["obstacles"] = [
        {"name": "ball", "sphere": {"centre": [0.004, 0.002, 0.139], "radius": 0.01}}]  # fmt: skip
    mapping["contact"] = {"between": [{"pair": ["body", "ball"]}], "alarm_distance": 0.01,
                          "contact_distance": 0.0005}  # fmt: skip
    mapping["solver"] = {"newton_iterations": 20, "residual_tolerance": 1.0e-8}
    scene = scene_from_mapping(mapping, half_trained)
    reduced = Simulation(scene, with_warnings=False)
    full = Simulation(without_reductions(scene), with_warnings=False)
    for shortening in (0.002, 0.004, 0.006, 0.008, 0.008):
        for simulation in (full, reduced):
            lengths = simulation.rest_setpoints - shortening
            result = simulation.step(CommandSetpoints(lengths, ANY_TIME))
    assert result.report.contact_count == 1
    true = np.linalg.norm(reduced.effector_positions() - full.effector_positions())
    judge = FullModelError(reduced)
    assert judge.errors(reduced.state)["body"].distance == pytest.approx(true, rel=0.1)
    assert 0.0 < ReductionStates(reduced).read()["body"].error < true
