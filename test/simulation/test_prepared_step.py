"""A step that was prepared is the same, to the bit, as one that was not."""

import numpy as np
import pytest

from softrobot_twin.analysis.apparent_compliance import EffectorCompliance
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import (
    CommandEfforts,
    CommandSetpoints,
    FollowTargets,
    Hold,
    Simulation,
)
from test.places import SCENES

STEP = 0.02
BETWEEN = ["save", "restore", "reset", "compliance", "forget"]


def same(first, second) -> bool:
    """Whether two results and their states are the same to the bit."""
    arrays = [(getattr(first.state, name), getattr(second.state, name))
              for name in ("positions", "setpoints", "efforts", "velocities")]  # fmt: skip
    arrays += [(array, second.state.memory[key]) for key, array in first.state.memory.items()]
    arrays += [(first.effector_positions, second.effector_positions),
               (first.effector_errors, second.effector_errors)]  # fmt: skip
    is_alike = first.status is second.status and first.report.iterations == second.report.iterations
    return is_alike and all(np.array_equal(*both, equal_nan=True) for both in arrays)


def was_prepared(result) -> bool:
    """Whether a step had no contacts to detect and no tangent to assemble before it condensed."""
    return next(iter(result.report.stage_times)) == "condense"


def draw_command(rng, simulation, step=STEP):
    """A command of any kind near the state."""
    kind = rng.choice(["hold", "setpoints", "efforts", "targets"])
    setpoints, scale = simulation.state.setpoints, simulation.limits.displacement_scale
    if kind == "setpoints":
        return CommandSetpoints(setpoints - 0.02 * scale * rng.random(len(setpoints)), step)
    if kind == "efforts":
        shares = rng.uniform(0.5, 1.5, len(setpoints))
        return CommandEfforts(simulation.state.efforts * shares, step)
    if kind == "targets" and len(simulation.effector_names):
        places = simulation.effector_positions()
        return FollowTargets(places + rng.uniform(-0.002, 0.002, places.shape), step)
    return Hold(step)


# Full, reduced, in motion by both schemes, beams, springs, hinges, contact with friction; guided.
@pytest.mark.sampled
@pytest.mark.parametrize("name, is_prepared", [
    ("finger", True), ("diamond_reduced", True), ("fast_trunk", True), ("tdcr", True),
    ("springy", True), ("strider", True), ("finray", True), ("fast_pneunet", True),
    ("pneunet", False)])  # fmt: skip
def test_a_run_with_steps_prepared_is_the_same_to_the_bit(name, is_prepared, drawn_rng):
    scene = load_scene(SCENES / f"{name}.yaml")
    plain, other = (Simulation(scene, with_warnings=False) for _ in range(2))
    kept = plain.state, other.state
    for _ in range(16):
        command = draw_command(drawn_rng, plain, STEP * drawn_rng.choice([1.0, 1.0, 1.0, 0.4]))
        # What follows may be as was thought, of another duration, or asked in another way.
        likely = drawn_rng.choice([command, command, Hold(command.time_step), Hold(0.3 * STEP)])
        for _ in range(drawn_rng.integers(0, 3)):
            other.prepare(likely)
        between = drawn_rng.choice([*["nothing"] * 6, *BETWEEN])
        for index, simulation in enumerate((plain, other)):
            if between == "restore":
                simulation.restore(kept[index])
            elif between == "reset":
                simulation.reset()
            elif between == "forget":
                simulation.forget_solvers()
            elif between == "compliance" and not simulation.model.is_dynamic:
                EffectorCompliance(simulation).at_state()
        if between == "save":
            kept = plain.state, other.state
        first, second = plain.step(command), other.step(command)
        assert same(first, second)
    plain.reset()
    other.reset()
    results = []
    for _ in range(6):
        other.prepare(Hold(STEP))
        results.append((plain.step(Hold(STEP)), other.step(Hold(STEP))))
    assert all(same(*both) for both in results)
    # Not the first step of a robot with motors, and none after one whose tangent was projected.
    assert was_prepared(results[-1][1]) is is_prepared and not was_prepared(results[-1][0])


def prepared(simulation, command):
    """The simulation, with a step by the command prepared, which a step indeed takes."""
    simulation.prepare(command)
    assert was_prepared(simulation.step(command))
    simulation.prepare(command)
    return simulation


def test_a_reset_a_restored_state_and_a_look_at_the_model_drop_what_was_prepared(diamond):
    simulation = diamond()
    for drop in (simulation.reset, lambda: simulation.restore(simulation.state),
                 EffectorCompliance(simulation).at_state):  # fmt: skip
        drop = prepared(simulation, Hold(STEP)) and drop
        drop()
        assert not was_prepared(simulation.step(Hold(STEP)))
