"""Runs every branch of a step once, so that nothing is compiled or set up inside the loop."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.command import CommandEfforts, CommandSetpoints, FollowTargets, Hold
from softrobot_twin.simulation.step.inverse_choice import why_not_followed

# Positive, and short enough to change the state little [s].
TIME_STEP = 1.0e-3
# Share of a large displacement by which actuators are moved so that they bear.
TAUT = 1.0e-6
# Share of the robot's size by which targets are away: at its target a robot would rest.
AWAY = 0.01


def run_every_path(simulation) -> None:
    """Step a simulation by each kind of command that its scene takes.

    Args:
        simulation: The simulation; its state afterwards has no meaning.
    """
    def step(*given, **named):
        # What only its reader needs is compiled too.
        simulation.step(*given, **named).make()

    before, actuators = simulation.state, simulation.actuators
    here, turns = simulation.effector_positions(), simulation.effector_orientations()
    follows = not why_not_followed(simulation.model)
    step(Hold(TIME_STEP))
    if actuators.count:
        step(CommandSetpoints(before.setpoints, TIME_STEP))
        none = np.where(actuators.takes_efforts, 0.0, np.nan)
        step(CommandEfforts(none, TIME_STEP))
        taut = actuators.setpoints(TAUT * actuators.limits.drive_scale)
        if simulation.model.is_dynamic:
            # Cables go on moving, and would be slack.
            simulation.restore(before)
        # Tensions and pressures of the first of these have a stiffness in the second.
        for _ in range(2):
            simulation.newton.tangent.take_augmented_tangent()
            step(CommandSetpoints(taut, TIME_STEP))
    for part in simulation.parts:
        for measured in part.samples:
            step(Hold(TIME_STEP), None, measured)
    if follows:
        step(FollowTargets(here, TIME_STEP, None, turns))
        step(FollowTargets(here, TIME_STEP, None, turns), budget=0.0)
        if simulation.model.weighs_stiffness:
            # Any stiffness; that of the second step is found from the active limits of the first.
            wanted = np.where(np.array(simulation.stiff_effectors)[:, None], np.ones(3), np.nan)
            for _ in range(2):
                step(FollowTargets(here, TIME_STEP, None, turns, wanted))
        # So far the robot may have followed by the augmented tangent alone, and rested.
        simulation.restore(before)
        for _ in range(3):
            step(FollowTargets(here + AWAY * simulation.model.nodes.finite_size, TIME_STEP, None, turns))
