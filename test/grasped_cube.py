"""The Grasper without its motor, whose three cables move the cube that its fingers hold."""

from pathlib import Path

import yaml

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation

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
    closed = CommandSetpoints(simulation.rest_setpoints - shortening, STEP)
    for _ in range(steps):
        simulation.step(closed)
    simulation.model.guides.aim("palm", [0.0, 0.0, LIFT])
    for _ in range(90):
        simulation.step(closed)
    return simulation
