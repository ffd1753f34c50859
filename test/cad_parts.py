"""Parts as a CAD program exports them, made in tests."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path

import meshio
import numpy as np
import pytest

from test.shapes import Box


def need_gmsh() -> None:
    """Skips a test where gmsh or one of its libraries is missing."""
    try:
        import gmsh  # noqa: F401
    except (ImportError, OSError) as error:
        pytest.skip(f"gmsh cannot be loaded: {error}")


def lines_of(errors: str) -> list[str]:
    """Lines of standard error, without those that tell of an activity on a slow machine."""
    return [line for line in errors.splitlines() if not line.endswith(" …")]


def box(size, centre=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Points and outward triangles of a box."""
    shape = Box(np.array(centre, float), np.array(size, float))
    points, triangles = shape.surface(np.inf)
    return points + shape.centre - points.mean(axis=0), triangles


def joined(*parts) -> tuple[np.ndarray, np.ndarray]:
    """Several surfaces as one."""
    points, triangles, count = [], [], 0
    for own, corners in parts:
        points.append(own)
        triangles.append(corners + count)
        count += len(own)
    return np.concatenate(points), np.concatenate(triangles)


def inside_out(part) -> tuple[np.ndarray, np.ndarray]:
    """A surface with all its normals reversed, as CAD programs write cavities."""
    return part[0], part[1][:, ::-1]


def write_stl(path: Path, part, binary: bool = True) -> Path:
    """Writes an STL file."""
    meshio.Mesh(part[0], [("triangle", part[1])]).write(path, file_format="stl", binary=binary)
    return path


def finger():
    """A finger of 60 × 20 × 16 mm along x from 0 with a chamber of 40 × 8 × 6 mm."""
    return joined(box((60, 20, 16), (30, 0, 0)), inside_out(box((40, 8, 6), (30, 0, 2))))


@contextmanager
def gmsh_session():
    """Gmsh, which tells nothing, for as long as it is needed."""
    import gmsh

    gmsh.initialize(["gmsh"], readConfigFiles=False, interruptible=False)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        yield gmsh
    finally:
        gmsh.finalize()


def write_step(path: Path, *solids, cut=()) -> Path:
    """Writes boxes, each a corner and a size [mm], as STEP; `cut` are cut out of the first."""
    with gmsh_session() as gmsh:
        occ = gmsh.model.occ
        made = [occ.addBox(*corner, *size) for corner, size in solids]
        if cut:
            tools = [(3, occ.addBox(*corner, *size)) for corner, size in cut]
            occ.cut([(3, made[0])], tools)
        occ.synchronize()
        gmsh.write(str(path))
    return path
