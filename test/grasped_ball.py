"""The PneuNet gripper with a valve for each finger, and the ball that its fingers hold."""

from pathlib import Path

import numpy as np
import yaml

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandEfforts, Simulation
from test.grasped_cube import STEP, close_and_lift

SCENE_FILE = Path(__file__).resolve().parents[1] / "config" / "scenes" / "pneunet_in_hand.yaml"
GRIP = 40e3


def valves(**of_pair) -> dict:
    """The mapping of the scene, with other values of the pairs of a finger and the ball."""
    entries = yaml.safe_load(SCENE_FILE.read_text())
    entries["contact"]["between"][0] |= of_pair
    return entries


def lifted_ball(entries: dict) -> Simulation:
    """The ball, held above the floor at the pressure of the grip."""
    simulation = Simulation(scene_from_mapping(entries, SCENE_FILE))
    close_and_lift(simulation, CommandEfforts(np.full(3, GRIP), STEP), 60)
    return simulation
