"""A robot as one unstructured mesh, for ParaView and other readers of VTK files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np

from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh
from softrobot_twin.geometry.quadratic_mesh import QuadraticMesh
from softrobot_twin.harness.output_file import OutputError, output_file
from softrobot_twin.mechanics.rotation import rotation_from_quaternion
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.appearance import rigid_poses
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.view.drawn_parts import rigid_skins


class _Part(NamedTuple):
    """A part of a robot.

    Attributes:
        name: Its name.
        now: Its points [m], shape (point_count, 3).
        rest: The same at rest.
        cells: Kind and nodes of its cells, numbered from 0.
    """

    name: str
    now: np.ndarray
    rest: np.ndarray
    cells: list[tuple[str, np.ndarray]]


def export_mesh(simulation: Simulation, path: Path | str) -> tuple[str, ...]:
    """Writes the present shape of all bodies and the displacements of their points.

    Deformable bodies have their cells, beams and cables their lines, rigid bodies their surfaces,
    masses their points and springs.

    Args:
        simulation: The simulation.
        path: File to write; its suffix determines the format, such as ``.vtu``.

    Returns:
        Names of the parts; the cell data ``part`` contains their numbers, from 0.

    Raises:
        OutputError: The file cannot be written, or meshio knows no such format.
    """
    parts = list(_parts(simulation))
    now = np.concatenate([part.now for part in parts])
    rest = np.concatenate([part.rest for part in parts])
    firsts = np.cumsum([0, *(len(part.now) for part in parts)])
    mesh = meshio.Mesh(
        now,
        [(kind, np.asarray(nodes, np.int64) + first)
         for part, first in zip(parts, firsts) for kind, nodes in part.cells],
        point_data={"displacement": now - rest},
        cell_data={"part": [np.full(len(nodes), number, np.int64)
                            for number, part in enumerate(parts) for _, nodes in part.cells]},
    )  # fmt: skip
    try:
        with output_file(path) as partial:
            meshio.write(partial, mesh)
    except (meshio.WriteError, meshio.ReadError, KeyError) as error:
        suffix = Path(path).suffix
        reason = f"meshio cannot write {suffix}" if suffix else "needs a suffix, such as .vtu"
        raise OutputError(path, reason) from error
    return tuple(part.name for part in parts)


def _parts(simulation: Simulation) -> Iterator[_Part]:
    """Deformable bodies, beams, rigid bodies, masses with their springs, and cables."""
    model = simulation.model
    now, rest = simulation.state.positions, model.nodes.rest_positions
    for body in model.bodies:
        nodes = body.shown_nodes(np.arange(_point_count(body)))
        yield _Part(body.name, nodes.positions(now), nodes.positions(rest), _cells(body))
    for beam in model.beams:
        nodes = beam.nodes_mapping()
        yield _Part(beam.name, nodes.positions(now), nodes.positions(rest), _line(beam.node_count))
    for skin, *places in zip(
        rigid_skins(simulation.model), _frames(simulation, now), _frames(simulation, rest), strict=True
    ):
        here, there = (origin + skin.points @ rotation.T for origin, rotation in places)
        yield _Part(skin.name, here, there, [("triangle", skin.triangles)])
    first = sum(body.scene_node_count for body in model.bodies)
    for entry in simulation.scene.mass_springs:
        own = slice(first, first + len(entry.points))
        first += len(entry.points)
        springs = [("line", np.array(entry.springs))] if entry.springs else []
        vertices = ("vertex", np.arange(len(entry.points))[:, None])
        yield _Part(entry.name, now[own], rest[own], [vertices, *springs])
    at_rest = model.actuators.paths(rest)
    for name, points in simulation.actuator_paths().items():
        if len(points) == len(at_rest[name]) > 1:
            yield _Part(name, points, at_rest[name], _line(len(points)))


def _line(count: int) -> list[tuple[str, np.ndarray]]:
    """Cells of a line through points."""
    return [("line", np.column_stack([np.arange(count - 1), np.arange(1, count)]))]


def _point_count(body: Body) -> int:
    """Number of nodes of a body that are points; they come first."""
    mesh = body.mesh
    return mesh.node_count if isinstance(mesh, QuadraticMesh) else mesh.corner_mesh.node_count


def _cells(body: Body) -> list[tuple[str, np.ndarray]]:
    """Kind and nodes of the cells of a body; meshio orders nodes as the meshes do, as VTK."""
    if isinstance(body.mesh, QuadraticMesh):
        return [("tetra10", body.mesh.cells)]
    corners = body.mesh.corner_mesh
    if isinstance(corners, HexahedralMesh):
        blocks = [("tetra", corners.tets), ("hexahedron", corners.hexahedra)]
        return [(kind, nodes) for kind, nodes in blocks if len(nodes)]
    return [("tetra", corners.cells)]


def _frames(simulation: Simulation, positions: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Origin and rotation of each rigid body at node positions [m]."""
    origins, quaternions = rigid_poses(simulation.model, positions)
    return [(origin, rotation_from_quaternion(quaternion))
            for origin, quaternion in zip(origins, quaternions, strict=True)]
