"""``python -m softrobot_twin explain``: what a scene calls for, and what that makes."""

from __future__ import annotations

from pathlib import Path

from softrobot_twin.simulation import Simulation
from softrobot_twin.study.offline.explanation import effects, sizes, terms
from softrobot_twin.study.offline.mesh_error_words import tell_mesh_error
from softrobot_twin.study.reports.terminal import console, table, warn


def explain(scene: Path, mesh_error: bool = True) -> int:
    """Prints a scene's effects, terms, stages, size, the error of its mesh and notes.

    Args:
        scene: Scene file.
        mesh_error: Whether the error of its mesh is estimated.

    Returns:
        Exit code, always 0.

    Raises:
        SoftRobotTwinError: The scene or its mesh cannot be used.
    """
    simulation = Simulation.from_scene_file(scene)
    asked = table("What the scene calls for", "entry", "asked", "makes")
    for effect in effects(simulation):
        asked.add_row(*effect)
    made = table("Terms of a step", "term", "kind", "built from", "size")
    for line in terms(simulation):
        made.add_row(*line)
    stages = table("Stages of a step", "order", "stage")
    for order, stage in enumerate(simulation.stages, start=1):
        stages.add_row(str(order), stage)
    size = table("Size", "what", "value")
    for row in sizes(simulation):
        size.add_row(*row)
    output = console()
    output.print(f"{simulation.scene.name}: {scene}\n")
    for shown in (asked, made, stages, size):
        output.print(shown)
        output.print()
    if mesh_error:
        tell_mesh_error(simulation.scene, with_table=True)
    for note in simulation.notes:
        warn(note)
    return 0
