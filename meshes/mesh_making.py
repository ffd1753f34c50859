"""Common parts of the scripts that make meshes: arguments, quality checks, writing."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.closed_surface import closed_surface
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.tet_mesh import TetMesh


# Share of the stated volume by which a cavity may differ.
VOLUME_TOLERANCE = 0.01


@dataclass(frozen=True, eq=False)
class PneumaticMesh:
    """A body with cavities.

    Attributes:
        mesh: The body.
        regions: Tetrahedra of each region of the body, by its name.
        cavities: Closed triangle surface of each cavity, by its name: nodes of the body, normals
            out of the gas, shape (triangle_count, 3).
        bricks: Hexahedra of each region that are written in place of its tetrahedra, which fill
            them, shape (brick_count, 8); empty where tetrahedra are written.
    """

    mesh: TetMesh
    regions: dict[str, np.ndarray]
    cavities: dict[str, np.ndarray]
    bricks: dict[str, np.ndarray] = field(default_factory=dict)

    def cavity_volume(self, name: str) -> float:
        """Volume of the gas in a cavity at rest [m³]."""
        corners = self.mesh.node_positions[self.cavities[name]]
        return float(np.linalg.det(corners).sum() / 6.0)


def mesh_parser(description: str, sizes, output: str = "folder") -> argparse.ArgumentParser:
    """Parser of a script's arguments: sizes to make and output folder.

    Args:
        description: What the script makes.
        sizes: Available refinements.
        output: What ``--output`` accepts, for the help.
    """
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(
        "--size", type=int, action="append", choices=sizes,
        help="refinement, about its number of nodes; may be repeated (default: all)",
    )  # fmt: skip
    parser.add_argument(
        "--output", type=Path, default=Path(__file__).resolve().parent,
        help=f"{output} (default: beside the script)",
    )  # fmt: skip
    return parser


def make_all(options, name: str, refinements: dict, make: Callable, judge: Callable) -> bool:
    """Makes the requested meshes, prints their properties, writes those that can be used.

    Args:
        options: Parsed arguments of `mesh_parser`.
        name: Beginning of the files' names, before the size.
        refinements: Refinement of each size.
        make: Makes a `TetMesh` or a `PneumaticMesh` of a refinement.
        judge: Returns the reasons why a mesh cannot be used, a list of sentences.

    Returns:
        True when all could be written.
    """
    written = True
    for size in [one for one in refinements if not options.size or one in options.size]:
        made = make(refinements[size])
        if isinstance(made, PneumaticMesh):
            path = options.output / f"{name}_{size}.msh"
            written &= write_usable_pneumatic(path, made, judge(made))
        else:
            written &= write_usable(options.output / f"{name}_{size}.vtk", made, judge(made))
    return written


def write_usable(path: Path, mesh: TetMesh, faults: list[str]) -> bool:
    """Prints a mesh's properties and faults, and writes it when it has no faults.

    Args:
        path: File to write.
        mesh: The mesh.
        faults: Reasons why it cannot be used, as from `faults_of`.

    Returns:
        True when it was written.
    """
    if _may_be_written(path, mesh, faults):
        write_mesh(path, mesh)
    return not faults


def write_usable_pneumatic(path: Path, made: PneumaticMesh, faults: list[str]) -> bool:
    """Does the same as `write_usable` for a body with cavities."""
    usable = _may_be_written(path, made.mesh, faults)
    parts = [f"{name} {len(tets)} tets" for name, tets in made.regions.items()]
    parts += [f"{name} {1e9 * made.cavity_volume(name):.0f} mm³" for name in made.cavities]
    print(f"  {', '.join(parts)}")
    if usable:
        write_pneumatic_mesh(path, made)
    return usable


def _may_be_written(path: Path, mesh: TetMesh, faults: list[str]) -> bool:
    """Prints a mesh's properties and faults; whether it has none."""
    ratios = radius_ratios(mesh)
    print(
        f"{path.name}: {mesh.node_count} nodes, {mesh.cell_count} tets, "
        f"{1e9 * mesh.volume:.0f} mm³, radius ratio min {ratios.min():.3f} "
        f"mean {ratios.mean():.3f}"
    )
    for fault in faults:
        print(f"{path.name} is not written: {fault}.", file=sys.stderr)
    return not faults


def faults_of(mesh: TetMesh, cable_points: np.ndarray, lowest_radius_ratio: float) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences.

    Args:
        mesh: The mesh.
        cable_points: Points of cables that must lie in it [mm], shape (count, 3).
        lowest_radius_ratio: Least radius ratio that is good enough.
    """
    faults = quality_faults(mesh, lowest_radius_ratio)
    farthest = locate_points(mesh, 1e-3 * cable_points).distances.max()
    if farthest > 1e-6:
        faults.append(f"a point of a cable lies {1e3 * farthest:.3f} mm outside")
    return faults


def quality_faults(mesh: TetMesh, lowest_radius_ratio: float) -> list[str]:
    """The sentence on a tetrahedron that is too flat, if there is one."""
    lowest = radius_ratios(mesh).min()
    if lowest < lowest_radius_ratio:
        return [f"the worst radius ratio is {lowest:.3f}, under {lowest_radius_ratio}"]
    return []


def pneumatic_faults(
    made: PneumaticMesh,
    volumes: dict[str, float],
    symmetries: dict[str, np.ndarray],
    lowest_radius_ratio: float,
) -> list[str]:
    """Reasons why a body with cavities cannot be used, as sentences.

    Args:
        made: The body.
        volumes: Volume that each cavity must have [mm³].
        symmetries: Matrices that map the mesh onto itself, each of shape (3, 3), by their names.
        lowest_radius_ratio: Least radius ratio that is good enough.
    """
    faults = quality_faults(made.mesh, lowest_radius_ratio)
    if set(made.cavities) != set(volumes):
        faults.append(f"it has the cavities {sorted(made.cavities)}, not {sorted(volumes)}")
    for name in set(made.cavities) & set(volumes):
        faults += _cavity_faults(made, name, volumes[name])
    faults += [
        f"{name} does not map it onto itself"
        for name, matrix in symmetries.items()
        if not maps_onto_itself(made.mesh, matrix)
    ]
    return faults


def _cavity_faults(made: PneumaticMesh, name: str, volume: float) -> list[str]:
    """Sentences on a cavity that is open, not the body's, or of another volume [mm³]."""
    try:
        closed_surface(made.cavities[name], made.mesh.node_count)
    except MeshError as error:
        return [f"{name} is not closed: {error}"]
    surface = {_cycle(triangle) for triangle in made.mesh.surface_triangles}
    loose = sum(_cycle(triangle[::-1]) not in surface for triangle in made.cavities[name])
    faults = [f"{loose} triangles of {name} are not on the body's surface"] if loose else []
    found = 1e9 * made.cavity_volume(name)
    if abs(found - volume) > VOLUME_TOLERANCE * volume:
        faults.append(f"{name} has {found:.0f} mm³, not {volume:.0f}")
    return faults


def _cycle(triangle: np.ndarray) -> tuple[int, ...]:
    """A triangle's nodes from the lowest one on, in their order."""
    return tuple(np.roll(triangle, -int(np.argmin(triangle))).tolist())


def maps_onto_itself(mesh: TetMesh, matrix: np.ndarray) -> bool:
    """Whether a matrix, shape (3, 3), maps nodes onto nodes and tetrahedra onto tetrahedra."""
    positions = mesh.node_positions
    distances, image = KDTree(positions).query(positions @ np.transpose(matrix))
    size = np.linalg.norm(np.ptp(positions, axis=0))
    if distances.max() > 1e-6 * size:
        return False
    mapped, tets = (np.sort(cells, axis=1) for cells in (image[mesh.cells], mesh.cells))
    return np.array_equal(np.unique(mapped, axis=0), np.unique(tets, axis=0))


def turn_about_z(fraction: int) -> np.ndarray:
    """Matrix of a turn about z by 360° over a number, shape (3, 3)."""
    angle = 2.0 * np.pi / fraction
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def mirror(axis: int) -> np.ndarray:
    """Matrix of the mirror image in the plane through the origin, normal to an axis."""
    return np.diag(np.where(np.arange(3) == axis, -1.0, 1.0))


def oriented_tets(positions: np.ndarray, tets: np.ndarray) -> np.ndarray:
    """The tetrahedra with two nodes swapped where the volume is negative, shape (tet_count, 4)."""
    negative = np.linalg.det(positions[tets[:, 1:]] - positions[tets[:, :1]]) < 0.0
    tets = tets.copy()
    tets[negative] = tets[negative][:, [0, 1, 3, 2]]
    return tets


def write_mesh(path: Path, mesh: TetMesh) -> None:
    """Writes a mesh in VTK version 4.2, whose indices have four bytes (eight in version 5.1)."""
    import meshio

    path.parent.mkdir(parents=True, exist_ok=True)
    content = meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)])
    content.write(path, file_format="vtk42", binary=True)


def write_pneumatic_mesh(path: Path, made: PneumaticMesh) -> None:
    """Writes regions as physical volumes and cavities as physical surfaces, Gmsh version 2.2."""
    import meshio

    path.parent.mkdir(parents=True, exist_ok=True)
    blocks = [("tetra", made.mesh.cells[tets]) for tets in made.regions.values()]
    if made.bricks:
        blocks = [("hexahedron", made.bricks[name]) for name in made.regions]
    blocks += [("triangle", triangles) for triangles in made.cavities.values()]
    names = {name: 3 for name in made.regions} | {name: 2 for name in made.cavities}
    tags = [
        np.full(len(cells), tag, dtype=np.int32) for tag, (_, cells) in enumerate(blocks, start=1)
    ]
    content = meshio.Mesh(
        made.mesh.node_positions,
        [(kind, cells.astype(np.int32)) for kind, cells in blocks],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={
            name: np.array([tag, dimension])
            for tag, (name, dimension) in enumerate(names.items(), start=1)
        },
    )
    content.write(path, file_format="gmsh22", binary=True)
