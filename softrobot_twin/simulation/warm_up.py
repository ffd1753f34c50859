"""Every path of a step run once, so that nothing is compiled or set up inside the loop."""

from __future__ import annotations

import numpy as np

from softrobot_twin.simulation.command import FollowTargets, Hold, CommandSetpoints, CommandEfforts
from softrobot_twin.simulation.interpretation import why_not_followed

# Long enough to be a step in time, short enough to change little [s].
TIME_STEP = 1.0e-3


def run_every_path(simulation) -> None:
    """Step a simulation by each kind of command that its scene takes.

    Args:
        simulation: The simulation; where it stands afterwards means nothing.
    """
    lengths = simulation.state.setpoints
    simulation.step(Hold(TIME_STEP))
    if len(lengths):
        simulation.step(CommandSetpoints(lengths, TIME_STEP))
        sliding = np.isin(simulation.actuator_names, simulation.slide_names)
        simulation.step(CommandEfforts(np.where(sliding, np.nan, 0.0), TIME_STEP))
    if not why_not_followed(simulation.model):
        here = simulation.effector_positions()
        simulation.step(FollowTargets(here, TIME_STEP))
        simulation.step(FollowTargets(here, TIME_STEP), budget=0.0)
