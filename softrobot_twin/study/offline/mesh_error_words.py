"""What the mesh of a scene leaves out, on a terminal."""

from __future__ import annotations

from rich.table import Table

from softrobot_twin.scene import Scene
from softrobot_twin.simulation.mesh_error import MeshError, MeshErrorEstimator
from softrobot_twin.simulation.still_scene import MeshErrorUnknown
from softrobot_twin.study.reports.terminal import console, table, terminal_status, warn


def tell_mesh_error(scene: Scene, with_table: bool = False) -> None:
    """Prints the estimated error of the mesh.

    Args:
        scene: The scene.
        with_table: Whether each load is shown too, and a large error is warned of.
    """
    try:
        with terminal_status("solving with elements of higher order, to estimate the mesh's error"):
            error = MeshErrorEstimator(scene).at_rest()
    except MeshErrorUnknown as unknown:
        console().print(str(unknown))
        return
    if with_table:
        console().print(_by_load(error))
        console().print()
    if with_table and error.is_large:
        warn(error.in_words())
    else:
        console().print(error.in_words())


def _by_load(error: MeshError) -> Table:
    made = table("What the mesh leaves out of the effectors' motion, estimated", "load",
                 f"{error.own.element}, force given", "length given",
                 "quadratic, force given", "length given")
    better = {load.load: load for load in error.quadratic.loads}
    for own in error.own.loads:
        fine = better[own.load]
        made.add_row(own.load, *(_percent(share) for share in
                                 (own.forces, own.lengths, fine.forces, fine.lengths)))
    return made


def _percent(share: float) -> str:
    return "" if share != share else f"{100.0 * share:.2g} %"
