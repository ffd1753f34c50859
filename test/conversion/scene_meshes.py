"""Meshes that the scenes of the tests name, in the units of the scenes."""

from pathlib import Path

import meshio
import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.geometry.surface import boundary_triangles
from test.cad_parts import box
from test.places import ROOT


def write_meshes(folder: Path) -> None:
    """Writes all meshes: a bar, a bar with a chamber, their surfaces, a cube, a floor, a Diamond."""
    folder.mkdir()
    bar = read_box((100.0, 20.0, 20.0), (10, 2, 2)).mesh
    _write(folder / "bar.vtk", bar.node_positions, tetra=bar.as_tets)
    number = np.ones(len(bar.as_tets), int)
    meshio.write(folder / "bar.msh", meshio.Mesh(
        bar.node_positions, {"tetra": bar.as_tets}, cell_data={"gmsh:physical": [number], "gmsh:geometrical": [number]}),
        file_format="gmsh22", binary=False)  # fmt: skip
    rows = [f"{index + 1} {x} {y} {z}" for index, (x, y, z) in enumerate(bar.node_positions)]
    tets = [f"{index + 1} " + " ".join(map(str, tet + 1)) for index, tet in enumerate(bar.as_tets)]
    (folder / "bar.gidmsh").write_text("\n".join([
        "MESH dimension 3 ElemType Tetrahedra Nnode 4", "Coordinates", *rows, "End Coordinates", "",
        "Elements", *tets, "End Elements", ""]))  # fmt: skip
    _write_hollow(folder)
    for name, (points, triangles) in (("cube", box((2.0, 2.0, 2.0))), ("floor", _square())):
        _write(folder / f"{name}.obj", points, triangle=triangles)
    # The Diamond lies on its side in its file, and in millimetres.
    diamond = meshio.read(ROOT / "meshes/diamond_200.vtk")
    turned = Rotation.from_euler("x", -90.0, degrees=True).apply(1e3 * diamond.points - [0.0, 0.0, 35.0])
    _write(folder / "diamond.vtk", turned, tetra=diamond.cells_dict["tetra"])


def _write_hollow(folder: Path) -> None:
    """A bar with walls of 5 mm around a chamber."""
    whole = read_box((100.0, 20.0, 20.0), (10, 4, 4)).mesh
    middles = whole.node_positions[whole.as_tets].mean(axis=1)
    inside = ((middles > [20.0, 5.0, 5.0]) & (middles < [80.0, 15.0, 15.0])).all(axis=1)
    tets = whole.as_tets[~inside]
    used, place = np.unique(tets, return_inverse=True)
    points, tets = whole.node_positions[used], place.reshape(tets.shape)
    _write(folder / "hollow.vtk", points, tetra=tets)
    triangles = boundary_triangles(tets)
    at_wall = ((points >= [20.0, 5.0, 5.0]) & (points <= [80.0, 15.0, 15.0])).all(axis=1)[triangles].all(axis=1)
    _write(folder / "chamber.obj", points, triangle=triangles[at_wall][:, ::-1])
    _write(folder / "skin.obj", points, triangle=triangles[~at_wall])


def _square() -> tuple[np.ndarray, np.ndarray]:
    corners = np.array([[0.0, -300, -300], [0, 300, -300], [0, 300, 300], [0, -300, 300]])
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _write(path: Path, points: np.ndarray, **cells: np.ndarray) -> None:
    formats = {".vtk": "vtk42", ".obj": "obj"}
    meshio.write(path, meshio.Mesh(points, cells), file_format=formats[path.suffix])
