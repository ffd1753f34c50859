"""A scene with some keys changed: another mesh, element, law, or number of iterations."""

from __future__ import annotations

from pathlib import Path

from softrobot_twin.scene import Scene
from softrobot_twin.scene.body_entries import Region


def with_mesh_file(scene: Scene, file: Path) -> Scene:
    """The same scene on another mesh, which is placed as its own was."""
    return _with_body(scene, mesh=scene.body.mesh.model_copy(update={"file": file}))


def with_placed_mesh(scene: Scene, file: Path, fixed: tuple[Region, ...]) -> Scene:
    """The same scene on a mesh that already stands in its place, in metres."""
    placed = {"file": file, "scale": 1.0, "rotation": (0.0,) * 3, "translation": (0.0,) * 3}
    return _with_body(scene, mesh=scene.body.mesh.model_copy(update=placed), fixed=fixed)


def with_element(scene: Scene, element: str) -> Scene:
    """The same scene with linear or quadratic tetrahedra."""
    return _with_body(scene, element=element)


def with_law(scene: Scene, law: str) -> Scene:
    """The same scene under another law."""
    return _with_body(scene, material=scene.body.material.model_copy(update={"law": law}))


def with_newton(scene: Scene, iterations: int, tolerance: float) -> Scene:
    """The same scene with so many linearizations a step, down to a residual [N]."""
    changed = {"newton_iterations": iterations, "residual_tolerance": tolerance}
    return scene.model_copy(update={"solver": scene.solver.model_copy(update=changed)})


def with_hold_radius(scene: Scene, radius: float) -> Scene:
    """The same scene; cables that held on points hold on what lies within a radius [m]."""
    return _with_cables(scene, lambda cable: {"hold_radius": cable.hold_radius or radius})


def without_rate_limits(scene: Scene) -> Scene:
    """The same scene, in which any length can be reached in one step."""
    return _with_cables(scene, lambda _: {"rate": None})


def without_tension_limits(scene: Scene) -> Scene:
    """The same scene with cables that never tear: stiff coarse meshes need much force."""
    return _with_cables(scene, lambda cable: {"tension": (0.0, 1e3 * cable.tension[1] or 1e3)})


def weightless(scene: Scene) -> Scene:
    """The same scene without gravity."""
    return scene.model_copy(update={"gravity": (0.0, 0.0, 0.0)})


def _with_body(scene: Scene, **changes) -> Scene:
    return scene.model_copy(update={"body": scene.body.model_copy(update=changes)})


def _with_cables(scene: Scene, change) -> Scene:
    cables = tuple(cable.model_copy(update=change(cable)) for cable in scene.cables)
    return scene.model_copy(update={"cables": cables})
