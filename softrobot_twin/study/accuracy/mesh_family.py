"""Meshes of one body, from coarse to fine: those beside the scene's own, or refined from it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

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
    """

    name: str
    scene: Scene
    tet_count: int
    node_count: int
    size: float
    is_own: bool


def mesh_family(scene: Scene, folder: Path, most_tets: float = np.inf) -> list[MeshLevel]:
    """The meshes of a scene's body, the coarsest first.

    ``robot_1600.vtk`` has a family when ``robot_400.vtk`` or the like stands beside it. A mesh
    without one is refined uniformly, up to `REFINEMENTS` times.

    Args:
        scene: The scene.
        folder: Where refined meshes are written.
        most_tets: Finer meshes are left out, but never the scene's own.

    Raises:
        SoftRobotTwinError: A mesh cannot be used.
    """
    own = scene.mesh_path
    siblings = _siblings(own)
    if len(siblings) > 1:
        levels = [_level(path.stem, with_mesh_file(scene, path.resolve()), path == own)
                  for path in siblings]
    else:
        levels = _refined(scene, folder, most_tets)
    kept = [level for level in levels if level.is_own or level.tet_count <= most_tets]
    return sorted(kept, key=lambda level: level.tet_count)


def _siblings(own: Path) -> list[Path]:
    """Files beside a mesh whose names differ from it in the number at their end."""
    named = re.fullmatch(r"(.*?)_?\d+", own.stem)
    if not named:
        return [own]
    pattern = re.compile(re.escape(named[1]) + r"_?\d+" + re.escape(own.suffix))
    return [path for path in own.parent.iterdir() if pattern.fullmatch(path.name)]


def _level(name: str, scene: Scene, is_own: bool) -> MeshLevel:
    mesh = only_body(with_element(scene, "linear")).mesh
    size = float(np.cbrt(mesh.volume / mesh.tet_count))
    return MeshLevel(name, scene, mesh.tet_count, mesh.node_count, size, is_own)


def _refined(scene: Scene, folder: Path, most_tets: float) -> list[MeshLevel]:
    """The scene's own mesh and its refinements, held where it was held."""
    levels = [_level(scene.mesh_path.stem, with_mesh_file(scene, scene.mesh_path), True)]
    body = only_body(with_element(scene, "linear"))
    mesh, is_fixed = body.mesh, body.fixed
    for number in range(1, REFINEMENTS + 1):
        if 8 * mesh.tet_count > most_tets:
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
