"""Reading of triangle surfaces: obstacles, rigid bodies, and what bodies look like."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from pathlib import Path

import meshio
import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.closed_surface import closed_surface
from softrobot_twin.geometry.flat_regions import flattened
from softrobot_twin.geometry.mass_properties import surface_mass_properties
from softrobot_twin.geometry.repair import first_of_duplicates
from softrobot_twin.geometry.solid_surface import SolidSurface
from softrobot_twin.geometry.surface_mending import mend_surface

SUFFIXES = (".stl", ".obj", ".ply", ".vtk", ".vtu", ".msh")
# Points this near, relative to the surface's size, are one: STL files repeat each corner.
_COINCIDENT = 1.0e-7


def read_surface(
    path: Path, *, scale: float = 1.0,
    rotation: Sequence[float] = (0.0, 0.0, 0.0), translation: Sequence[float] = (0.0, 0.0, 0.0),
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Read triangles and place them: x = translation + Rz Ry Rx (scale · x_file).

    Args:
        path: File of triangles: .stl, .obj, .ply, .vtk, .vtu or .msh.
        scale: Metres in one unit of the file.
        rotation: Angles about the fixed x, then y, then z axis [rad], shape (3,).
        translation: Shift after scale and rotation [m], shape (3,).

    Returns:
        Points [m], shape (point_count, 3), and triangles, shape (triangle_count, 3).

    Raises:
        MeshError: The file cannot be read, or holds no triangles.
    """
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise MeshError(path, f"surface files end in {', '.join(SUFFIXES)}, not '{path.suffix}'")
    if not path.is_file():
        raise MeshError(path, "there is no such file")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        try:
            content = meshio.read(path)
        except (Exception, SystemExit) as error:  # a damaged file raises nearly anything there
            detail = " ".join(str(error).split()) or "no reason given"
            raise MeshError(path, f"cannot be read ({type(error).__name__}: {detail})") from None
    triangles = [block.data for block in content.cells if block.type == "triangle"]
    if sum(map(len, triangles)) == 0:
        raise MeshError(path, "has no triangles")
    points = np.asarray(content.points, float)
    if not np.isfinite(points).all():
        raise MeshError(path, "has points that are not finite")
    placed = Rotation.from_euler("xyz", rotation).apply(scale * points) + translation
    return _merged(placed, np.concatenate(triangles).astype(np.int64))


def _merged(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """One point where several lie, and none that no triangle uses."""
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    triangles = first_of_duplicates(points, _COINCIDENT * size)[triangles]
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    used, index = np.unique(triangles, return_inverse=True)
    return points[used], index.reshape(-1, 3)


def read_solid_surface(path: Path, *, notes: list[str], **placement) -> SolidSurface:
    """Read a closed surface.

    Args:
        path: File of triangles.
        notes: Takes what was mended.
        **placement: See `read_surface`.

    Returns:
        The surface, its triangles outward.

    Raises:
        MeshError: The file cannot be read, or its surface is open, crosses itself or encloses
            nothing.
    """
    path = Path(path)
    points, triangles = read_surface(path, **placement)
    mended = mend_surface(points, triangles)
    used, index = np.unique(mended.triangles, return_inverse=True)
    points, triangles = points[used], np.ascontiguousarray(index.reshape(-1, 3))
    try:
        closed_surface(triangles, len(points))
        surface_mass_properties(points, triangles)
    except MeshError as error:
        raise MeshError(path, error.reason) from None
    for note in mended.notes:
        line = f"{path.name}: {note}."
        if line not in notes:
            notes.append(line)
    return SolidSurface(flattened(points, triangles), triangles)
