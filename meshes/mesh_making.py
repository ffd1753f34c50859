"""Common parts of the scripts that make meshes: arguments, quality checks, writing."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.tet_mesh import TetMesh


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
        make: Makes a `TetMesh` of a refinement.
        judge: Returns the reasons why a mesh cannot be used, a list of sentences.

    Returns:
        True when all could be written.
    """
    written = True
    for size in options.size or refinements:
        path, mesh = options.output / f"{name}_{size}.vtk", make(refinements[size])
        written &= write_usable(path, mesh, judge(mesh))
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
    ratios = radius_ratios(mesh)
    print(
        f"{path.name}: {mesh.node_count} nodes, {mesh.cell_count} tets, "
        f"{1e9 * mesh.volume:.0f} mm³, radius ratio min {ratios.min():.3f} "
        f"mean {ratios.mean():.3f}"
    )
    for fault in faults:
        print(f"{path.name} is not written: {fault}.", file=sys.stderr)
    if not faults:
        write_mesh(path, mesh)
    return not faults


def faults_of(mesh: TetMesh, cable_points: np.ndarray, lowest_radius_ratio: float) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences.

    Args:
        mesh: The mesh.
        cable_points: Points of cables that must lie in it [mm], shape (count, 3).
        lowest_radius_ratio: Least radius ratio that is good enough.
    """
    faults = []
    lowest = radius_ratios(mesh).min()
    if lowest < lowest_radius_ratio:
        faults.append(f"the worst radius ratio is {lowest:.3f}, under {lowest_radius_ratio}")
    farthest = locate_points(mesh, 1e-3 * cable_points).distances.max()
    if farthest > 1e-6:
        faults.append(f"a point of a cable lies {1e3 * farthest:.3f} mm outside")
    return faults


def write_mesh(path: Path, mesh: TetMesh) -> None:
    """Writes a mesh in VTK version 4.2, whose indices have four bytes (eight in version 5.1)."""
    import meshio

    path.parent.mkdir(parents=True, exist_ok=True)
    content = meshio.Mesh(mesh.node_positions, [("tetra", mesh.cells)])
    content.write(path, file_format="vtk42", binary=True)
