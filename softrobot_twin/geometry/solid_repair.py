"""Repair of surfaces that enclose no solid: holes are closed, and overlapping solids united."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.ear_clipping import clip_ears
from softrobot_twin.geometry.mesh_repair import first_of_duplicates
from softrobot_twin.geometry.solid_shells import (
    at,
    connected_shells,
    first_crossing,
    is_inside,
    outward_shells,
    refuse_open,
)
from softrobot_twin.geometry.surface_reading import boundary_loops, repair_surface

INSTALL = "pip install manifold3d"
"""Installs what unites solids."""
_BY_HAND = "that is not repaired; repair it in the program that wrote it, or export it as STEP"
# Distance, relative to the size of the surface, within which points of united solids are one.
_COINCIDENT = 1.0e-6


def repair_solids(
    path: Path, points: np.ndarray, triangles: np.ndarray, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Closes holes, takes out walls between solids that touch, and unites solids that overlap.

    Args:
        path: The file, for errors.
        points: Points [m], coincident ones merged, shape (point_count, 3).
        triangles: Point indices, shape (triangle_count, 3).
        notes: List to which a note on each repair is appended.

    Returns:
        Points [m], shape (n, 3), and triangles with normals out of the material, shape (m, 3).

    Raises:
        MeshError: A surface meets or crosses itself, or a hole has no shape that can be closed; or
            manifold3d is needed and not installed.
    """
    _, place, counts = np.unique(np.sort(triangles, axis=1), axis=0, return_inverse=True, return_counts=True)
    walls = (counts == 2)[place.ravel()] & _is_turned_pair(triangles, place.ravel())
    if walls.any() and not walls.all():
        triangles = triangles[~walls]
        notes.append(f"took out {int(walls.sum()) // 2} triangles of walls between touching solids")
    repaired = repair_surface(points, triangles)
    triangles = repaired.triangles
    notes += [note for note in repaired.notes if "all" not in note]
    patches = []
    for loop in boundary_loops(triangles):
        corners = points[loop[::-1]]
        ears = clip_ears(corners)
        if ears is None:
            raise MeshError(path, f"has a hole of {len(loop)} edges at {at(corners.mean(axis=0))}; "
                            f"{_BY_HAND}")  # fmt: skip
        patches.append(np.array(loop[::-1])[ears])
        width = 1e3 * float(np.linalg.norm(np.ptp(corners, axis=0)))
        notes.append(f"closed a hole of {len(loop)} edges, {width:.3g} mm wide, at "
                     f"{at(corners.mean(axis=0))}")  # fmt: skip
    if patches:
        triangles = repair_surface(points, np.vstack([triangles, *patches])).triangles
    refuse_open(path, points, triangles, _BY_HAND)
    shell_of = connected_shells(triangles)
    if shell_of.any() and first_crossing(points, triangles) is not None:
        points, triangles = _united(path, points, triangles, shell_of, notes)
    crossing = first_crossing(points, triangles)
    if crossing is not None:
        raise MeshError(path, f"its surface intersects itself at {at(crossing)}; {_BY_HAND}")
    return points, triangles


def _is_turned_pair(triangles: np.ndarray, group: np.ndarray) -> np.ndarray:
    """Whether a triangle and the other of its group have opposite directions, shape (n,)."""
    shifts = np.argmin(triangles, axis=1)[:, None] + np.arange(3)
    second = np.take_along_axis(triangles, shifts % 3, axis=1)[:, 1]
    low, high = (np.full(group.max() + 1, fill) for fill in (np.iinfo(np.int64).max, -1))
    np.minimum.at(low, group, second)
    np.maximum.at(high, group, second)
    return (low != high)[group]


def _united(
    path: Path, points: np.ndarray, triangles: np.ndarray, shell_of: np.ndarray, notes: list[str]
) -> tuple[np.ndarray, np.ndarray]:
    """The union of the solids between shells."""
    try:
        import manifold3d
    except ModuleNotFoundError:
        raise MeshError(path, f"has solids that overlap; manifold3d unites them, and is not "
                        f"installed: {INSTALL}") from None  # fmt: skip
    outward = outward_shells(points, triangles, shell_of)
    solids, cavities = {}, {}
    for shell in range(shell_of.max() + 1):
        used, corners = np.unique(outward[shell_of == shell], return_inverse=True)
        solid = manifold3d.Manifold(manifold3d.Mesh64(points[used], corners.reshape(-1, 3).astype(np.uint64)))
        if solid.status() != manifold3d.Error.NoError:
            raise MeshError(path, f"has a solid that is not closed ({solid.status()}); {_BY_HAND}")
        # Shells that cross are not nested: those whose normals point inwards are cavities.
        is_cavity = (outward[shell_of == shell] != triangles[shell_of == shell]).any()
        (cavities if is_cavity else solids)[shell] = solid
    for shell, cavity in cavities.items():
        place = points[triangles[shell_of == shell][0, 0]]
        around = [other for other in solids if is_inside(place, points[outward[shell_of == other]])]
        if around:
            owner = min(around, key=lambda other: solids[other].volume())
            solids[owner] = solids[owner] - cavity
    made = manifold3d.Manifold.batch_boolean([*solids.values()], manifold3d.OpType.Add).to_mesh64()
    positions, corners = np.asarray(made.vert_properties)[:, :3], np.asarray(made.tri_verts)
    size = float(np.linalg.norm(np.ptp(positions, axis=0)))
    corners = first_of_duplicates(positions, _COINCIDENT * size)[corners.astype(np.int64)]
    notes.append(f"united {len(solids)} solids that overlap or touch")
    return positions, corners
