"""Meshes of one body, from coarse to fine: those beside the scene's own, or refined from it."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError
from softrobot_twin.geometry.uniform_refinement import refine
from softrobot_twin.scene import Scene
from softrobot_twin.scene.deformable import Region
from softrobot_twin.study.accuracy.only_body import only_body
from softrobot_twin.study.accuracy.scene_variant import (
    with_element,
    with_mesh_file,
    with_placed_mesh,
)
from softrobot_twin.study.bench.structured_column import write_mesh
from softrobot_twin.study.reports.terminal import warn

VOLUME_TOLERANCE, BOUNDS_TOLERANCE = 0.05, 0.02
"""Meshes of one body may differ by such shares of its volume and its size: curved faces do."""
REFINEMENTS = 2
"""How often a mesh without a family is refined; each time it has eight times the tetrahedra."""


class MeshLevel(NamedTuple):
    """One mesh of a family.

    Attributes:
        name: What tables call it.
        scene: The scene on it.
        tet_count: Its tetrahedra.
        node_count: Its nodes.
        size: Mean size h of its elements, the cube root of their mean volume [m].
        is_own: True for the mesh that the scene itself names.
        volume: Volume of the body [m³].
        bounds: Its smallest and largest coordinates [m], shape (2, 3).
    """

    name: str
    scene: Scene
    tet_count: int
    node_count: int
    size: float
    is_own: bool
    volume: float
    bounds: np.ndarray


def mesh_family(
    scene: Scene, folder: Path, most_tets: float = np.inf,
    leave_out: Callable[[str], None] = warn,
) -> list[MeshLevel]:
    """The meshes of a scene's body, the coarsest first.

    ``robot_1600.vtk`` has a family when ``robot_400.vtk`` or the like stands beside it and is of
    the same body: its volume and its bounds agree. A mesh without one is refined uniformly, up to
    `REFINEMENTS` times. ``robot_v1.vtk`` has none: ``v1`` is a version.

    Args:
        scene: The scene.
        folder: Where refined meshes are written.
        most_tets: Finer meshes are left out, but never the scene's own.
        leave_out: Takes a line for each file that is not taken for one of the family.

    Raises:
        SoftRobotTwinError: A mesh cannot be used.
    """
    own = _level(scene.mesh_path.stem, with_mesh_file(scene, scene.mesh_path.resolve()), True)
    levels = [own]
    for path in _siblings(scene.mesh_path):
        try:
            level = _level(path.stem, with_mesh_file(scene, path.resolve()), False)
        except SoftRobotTwinError as error:
            leave_out(f"{path.name} is left out: {error}")
            continue
        if reason := _difference(own, level):
            leave_out(f"{path.name} is left out, it is another body than {own.name}: {reason}")
        else:
            levels.append(level)
    if len(levels) == 1:
        levels = _refined(scene, folder, most_tets)
    kept = [level for level in levels if level.is_own or level.tet_count <= most_tets]
    return sorted(kept, key=lambda level: level.tet_count)


def _siblings(own: Path) -> list[Path]:
    """Other files beside a mesh whose names differ from it in the number at their end."""
    named = re.fullmatch(r"(.*?)_?\d+", own.stem)
    if not named or re.search(r"(?i)(^|[^a-z])v$", named[1]):
        return []
    pattern = re.compile(re.escape(named[1]) + r"_?\d+" + re.escape(own.suffix))
    return [path for path in sorted(own.parent.iterdir())
            if pattern.fullmatch(path.name) and path.name != own.name]


def _difference(own: MeshLevel, other: MeshLevel) -> str:
    """Why two meshes are not of the same body; empty when they are."""
    grown = other.volume / own.volume - 1.0
    if abs(grown) > VOLUME_TOLERANCE:
        return (f"its volume differs by {100.0 * grown:+.1f} % "
                f"(at most {100.0 * VOLUME_TOLERANCE:g} % may)")
    size = float(np.linalg.norm(own.bounds[1] - own.bounds[0]))
    apart = float(np.abs(other.bounds - own.bounds).max())
    if apart > BOUNDS_TOLERANCE * size:
        return (f"its bounds differ by {1e3 * apart:.2f} mm (at most "
                f"{1e3 * BOUNDS_TOLERANCE * size:.2f} mm may)")
    return ""


def _level(name: str, scene: Scene, is_own: bool) -> MeshLevel:
    mesh = only_body(with_element(scene, "linear")).mesh
    size = float(np.cbrt(mesh.volume / mesh.cell_count))
    return MeshLevel(name, scene, mesh.cell_count, mesh.node_count, size, is_own, mesh.volume,
                     mesh.bounding_box)


def _refined(scene: Scene, folder: Path, most_tets: float) -> list[MeshLevel]:
    """The scene's own mesh and its refinements, held where it was held."""
    levels = [_level(scene.mesh_path.stem, with_mesh_file(scene, scene.mesh_path), True)]
    body = only_body(with_element(scene, "linear"))
    mesh, is_fixed = body.mesh, body.fixed
    for number in range(1, REFINEMENTS + 1):
        if 8 * mesh.cell_count > most_tets:
            break
        mesh, ends = refine(mesh)
        is_fixed = np.concatenate([is_fixed, is_fixed[ends].all(axis=1)])
        file = (folder / f"{scene.mesh_path.stem}_refined_{number}.vtk").resolve()
        folder.mkdir(parents=True, exist_ok=True)
        write_mesh(file, mesh)
        nodes = tuple(int(node) for node in np.flatnonzero(is_fixed))
        finer = with_placed_mesh(scene, file, (Region(nodes=nodes),))
        levels.append(_level(file.stem, finer, False))
    return levels
