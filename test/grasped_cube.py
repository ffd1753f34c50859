"""The Grasper without its motor, whose three cables move the cube that its fingers hold."""

from pathlib import Path

import yaml

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation
from softrobot_twin.simulation.command import Command
from test.scene_changes import repeat_step

SCENE_FILE = Path(__file__).resolve().parents[1] / "config" / "scenes" / "grasper.yaml"
STEP, LIFT = 0.02, 0.020


def hand() -> dict:
    """The mapping of the scene, with a winch for each cable."""
    entries = yaml.safe_load(SCENE_FILE.read_text())
    del entries["motors"]
    return entries


def lifted(entries: dict, shortening: float, steps: int) -> Simulation:
    """The cube, held above the floor by cables that are wound so far [m], in so many steps."""
    simulation = Simulation(scene_from_mapping(entries, SCENE_FILE))
    close_and_lift(simulation, CommandSetpoints(simulation.rest_setpoints - shortening, STEP), steps)
    return simulation


def close_and_lift(simulation: Simulation, closed: Command, steps: int) -> None:
    """Closes the fingers of a palm in so many steps, and lifts it."""
    repeat_step(simulation, closed, steps)
    simulation.model.guides.aim("palm", [0.0, 0.0, LIFT])
    repeat_step(simulation, closed, 90)
