"""The full model tells the error of a reduced body, also of what the basis cannot see."""

import numpy as np
import pytest

from softrobot_twin.scene import load_scene
from softrobot_twin.scene.schema import Touch
from softrobot_twin.simulation import CommandSetpoints, Simulation, State
from softrobot_twin.simulation.full_model_error import FullModelError
from softrobot_twin.simulation.reduced_body import without_reductions
from softrobot_twin.simulation.touches import Touched

ANY_TIME = 1.0e3
TRAINED = 0.011
FINGER = [0.2, -0.1, 0.15]


@pytest.fixture(scope="module")
def judge(half_trained):
    """Full and reduced simulation with a touch at the tip, exact and without rates; their judge."""
    scene = load_scene(half_trained)
    cables = tuple(cable.model_copy(update={"rate": None}) for cable in scene.cables)
    solver = scene.solver.model_copy(update={
        "newton_iterations": 30, "residual_tolerance": 1.0e-8})  # fmt: skip
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
        result = simulation.step(CommandSetpoints(lengths, ANY_TIME), touched=touched)
    assert result.report.residual < 1.0e-5
    return result.effector_positions[0]


@pytest.mark.parametrize("force", [[0.0, 0.0, 0.0], FINGER], ids=["free", "touched"])
@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_the_full_model_tells_the_error_within_a_tenth(judge, factor, force):
    full, reduced, errors = judge
    rest = reduced.model.effectors.positions(reduced.model.nodes.rest_positions)
    rng, ratios, by_spare_modes = np.random.default_rng(2), [], []
    for _ in range(6):
        shortening = factor * TRAINED * rng.random(4)
        shortening[rng.integers(4)] = factor * TRAINED
        true = np.linalg.norm(wound(full, shortening, force) - wound(reduced, shortening, force))
        found = errors.errors(reduced.state)["body"]
        ratios.append(found.distance / true)
        moved = np.linalg.norm(reduced.effector_positions() - rest)
        assert found.share == pytest.approx(found.distance / moved)
        by_spare_modes.append(reduced.reduction_state()["body"].error / true)
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
    errors.full.restore(lifted)
    for name in ("effector_positions", "marker_positions", "surface_positions"):
        np.testing.assert_allclose(
            getattr(errors.full, name)(), getattr(reduced, name)(), atol=1e-12, err_msg=name
        )
    np.testing.assert_array_equal(lifted.efforts, reduced.state.efforts)
    np.testing.assert_array_equal(lifted.setpoints, reduced.state.setpoints)


def test_judging_leaves_the_reduced_simulation_as_it_was(judge):
    _, reduced, errors = judge
    wound(reduced, np.array([0.004, 0.0, 0.002, 0.008]))
    before = reduced.state
    errors.errors(before)
    assert reduced.state is before
