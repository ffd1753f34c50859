"""Entries that name files of meshes and surfaces: those of the scene itself, or files that are written."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np

from softrobot_twin.conversion.computed_values import (
    UNMOVED,
    LoadedMesh,
    array_of,
    mesh_of,
    state_mesh,
    topology_of,
)
from softrobot_twin.conversion.rules import BodyRecord, Conversion, rounded
from softrobot_twin.conversion.scene_tree import SceneComponent
from softrobot_twin.geometry.surface import half_edges
from softrobot_twin.geometry.surface_reading import SUFFIXES


def own_file(conversion: Conversion, mesh: LoadedMesh, suffixes: Any = SUFFIXES) -> dict[str, Any] | None:
    """The scene's own file of a mesh with its placement; None where an entry cannot name it.

    Args:
        conversion: The conversion.
        mesh: The mesh.
        suffixes: Endings of the files that are read.
    """
    placement = mesh.placement
    if mesh.file is None or not placement.is_uniform or mesh.file.suffix.lower() not in suffixes:
        return None
    file = Path(os.path.relpath(mesh.file, conversion.output.resolve().parent)).as_posix()
    made = {"file": file, "scale": rounded(conversion.units.metre * placement.scale[0])}
    if placement.rotation.magnitude() > 1e-12:
        made["rotation"] = rounded(placement.rotation.as_euler("xyz"))
    if placement.translation.any():
        made["translation"] = conversion.length(placement.translation)
    return made


def surface_file(conversion: Conversion, record: BodyRecord, mesh: LoadedMesh, name: str) -> dict[str, Any]:
    """The file of a surface on a body: the scene's own where it is placed like the body, else a written one.

    Args:
        conversion: The conversion.
        record: The body that carries the surface.
        mesh: The surface, in the unit of the file.
        name: Name of the cavity, or of what else it is, for a file that is written.

    Returns:
        Keys `file` and `scale` of an entry.
    """
    body = record.mesh.placement if "scale" in record.entry["mesh"] else UNMOVED
    is_same_place = (np.allclose(mesh.placement.translation, body.translation)
                     and (mesh.placement.rotation * body.rotation.inv()).magnitude() < 1e-9)  # fmt: skip
    own = own_file(conversion, mesh) if is_same_place else None
    if own is not None:
        return {key: own[key] for key in ("file", "scale")}
    # Where the surface is before the placement of the body's mesh.
    points = body.rotation.inv().apply(mesh.points - body.translation)
    return _written(conversion, points, mesh.triangles, name)


def _written(conversion: Conversion, points: np.ndarray, triangles: np.ndarray, name: str) -> dict[str, Any]:
    """A Wavefront file of a surface, whose points are in the unit of the scene."""
    lines = [f"v {x:.10g} {y:.10g} {z:.10g}\n" for x, y, z in points * conversion.units.metre]
    lines += [f"f {a} {b} {c}\n" for a, b, c in triangles + 1]
    file = f"{conversion.output.stem}_{name}.obj"
    conversion.files[file] = lambda path: path.write_text("".join(lines))
    return {"file": file}


def with_quads(mesh: LoadedMesh, component: SceneComponent) -> LoadedMesh:
    """A mesh with the quads of a component, as triangles.

    Args:
        mesh: The mesh.
        component: A topology or an actuator.
    """
    quads = array_of(component, 4, "quads")
    if quads is None or not len(quads):
        return mesh
    halves = quads.astype(np.int64)[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return mesh._replace(triangles=np.concatenate([mesh.triangles, halves]), file=None)


def surface_of(state: SceneComponent) -> LoadedMesh | None:
    """The triangles of a state's topology at its points before mappings; None without triangles.

    Args:
        state: A state of points.
    """
    topology = topology_of(state.node)
    if topology is None or topology.node is not state.node:
        return None
    mesh = with_quads(state_mesh(state)._replace(triangles=mesh_of(topology).triangles), topology)
    return mesh if len(mesh.triangles) else None


def normal_of(mesh: LoadedMesh, chosen: np.ndarray | slice = slice(None)) -> np.ndarray:
    """Mean normal of triangles by area, of length one, shape (3,).

    Args:
        mesh: The mesh.
        chosen: Which of its triangles count.
    """
    corners = mesh.points[mesh.triangles[chosen]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]).sum(axis=0)
    return normal / np.linalg.norm(normal)


def shape_entry(conversion: Conversion, mesh: LoadedMesh, name: str) -> dict[str, Any]:
    """The shape of a surface: a plane if it is flat, itself if it is closed, else its hull.

    Args:
        conversion: The conversion.
        mesh: The surface, in the frame of its carrier and the unit of the file.
        name: Name of the carrier, for a file that is written.
    """
    used = mesh.points[np.unique(mesh.triangles)]
    middle = used.mean(axis=0)
    spread = np.linalg.svd(used - middle, compute_uv=False)
    if spread[2] <= 1e-6 * spread[0]:
        return {"plane": {"point": conversion.length(middle), "normal": rounded(normal_of(mesh))}}
    # Coincident points are one.
    _, place = np.unique(np.round(mesh.points, 9), axis=0, return_inverse=True)
    _, _, _, counts = half_edges(np.ravel(place)[mesh.triangles])
    hull = {} if (counts == 2).all() else {"hull": True}
    own = own_file(conversion, mesh) or _written(conversion, mesh.points, mesh.triangles, name)
    return {"surface": own | hull}
