"""Scenes with one thing changed, as studies and the steps of reduced bodies need them.

A single value by its key is changed by `changed_scene` in `scene_parameters.py`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from softrobot_twin.scene.body_entries import Reduced
from softrobot_twin.scene.schema import Scene

# An equilibrium that others are compared with: linearizations, and share of the scene's tolerance.
MOST_ITERATIONS, EXACT = 60, 1.0e-3


def without_reductions(scene: Scene) -> Scene:
    """The same scene with all nodes of its reduced bodies as unknowns.

    Args:
        scene: The scene.
    """
    return scene.with_deformables({"reduced": None})


def without_vertebrae(scene: Scene) -> Scene:
    """The same scene with all nodes of its bodies as unknowns.

    Args:
        scene: The scene.
    """
    return scene.with_deformables({"vertebrae": None})


def with_mesh_file(scene: Scene, file: Path) -> Scene:
    """The same scene with another mesh file, placed by the same transformation.

    Args:
        scene: A scene with one body.
        file: The mesh file, absolute or relative to the scene's folder.
    """
    return scene.changed(body={"mesh": {"file": file}})


def with_newton(scene: Scene, iterations: int, tolerance: float) -> Scene:
    """The same scene with a number of linearizations per step and a residual tolerance [N].

    Args:
        scene: The scene.
        iterations: Linearizations in a step at most.
        tolerance: Largest residual force [N].
    """
    return scene.changed(solver={"newton_iterations": iterations, "residual_tolerance": tolerance})


def unlimited(scene: Scene, exact: bool = False) -> Scene:
    """The same scene without limits on rates; the volumes of its cavities are commanded.

    Args:
        scene: The scene.
        exact: Whether limits on displacements and efforts go too: stiff coarse meshes need large
            forces, and displacements are free when forces are prescribed.
    """
    of_cable: dict = {"rate": None}
    of_cavity: dict = {"rate": None, "flow": None, "control": "volume"}
    if exact:
        anything = -np.inf, np.inf
        of_cable |= {"tension": (0.0, 1.0e9), "shortening": (-10.0, 10.0)}
        of_cavity |= {"pressure": anything, "growth": anything, "volume": (0.0, np.inf)}
    return scene.changed(cables=of_cable, cavities=of_cavity)


def plain_surroundings(scene: Scene) -> dict[str, Any]:
    """Changes that leave out contact, what only watches, and what acts in runs alone.

    Args:
        scene: The scene; obstacles that cables wrap stay.
    """
    wrapped = {name for cable in scene.cables for name in cable.wraps}
    obstacles = tuple(one for one in scene.obstacles if one.name in wrapped)
    return dict(contact=None, obstacles=obstacles, sensors=(), reactions=(), grips=(), moving_base=None)


def full_scene(scene: Scene) -> Scene:
    """The scene in statics with all nodes free, without rates and contact, solved exactly.

    Args:
        scene: The scene.
    """
    def freed(entry):
        return entry.changed(rate=None) if hasattr(entry, "rate") else entry

    return scene.changed(
        integration="quasi_static", **plain_surroundings(scene),
        solver=dict(newton_iterations=MOST_ITERATIONS,
                    residual_tolerance=EXACT * scene.solver.residual_tolerance),
        **dict.fromkeys(scene.actuator_entries, freed),
    )  # fmt: skip


def reduced_scene(scene: Scene, body: str, file: Path) -> Scene:
    """A scene in which a body is reduced by a file.

    Args:
        scene: The scene of the full model.
        body: Name of the body.
        file: File of its reduced model.
    """
    reduced = Reduced(file=file.resolve())
    return scene.with_deformables(lambda one: one.changed(reduced=reduced) if one.name == body else one)
