"""A robot as one unstructured mesh, for ParaView and other readers of VTK files."""

from __future__ import annotations

from pathlib import Path

import meshio
import numpy as np

from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh
from softrobot_twin.geometry.quadratic_mesh import QuadraticMesh
from softrobot_twin.mechanics.rotation import rotation_from_quaternion
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.appearance import rigid_poses
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.study.output_file import OutputError, output_file


class _Parts:
    """Collects points and cells of the parts of a robot."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self._now: list[np.ndarray] = []
        self._rest: list[np.ndarray] = []
        self._cells: list[tuple[str, np.ndarray]] = []
        self._part_of_cells: list[np.ndarray] = []
        self._count = 0

    def add(
        self, name: str, now: np.ndarray, rest: np.ndarray, cells: list[tuple[str, np.ndarray]]
    ) -> None:
        """Adds a part.

        Args:
            name: Its name.
            now: Its points [m], shape (point_count, 3).
            rest: The same at rest.
            cells: Kind and nodes of its cells, numbered from 0.
        """
        number = len(self.names)
        self.names.append(name)
        self._now.append(now)
        self._rest.append(rest)
        for kind, nodes in cells:
            self._cells.append((kind, np.asarray(nodes, np.int64) + self._count))
            self._part_of_cells.append(np.full(len(nodes), number, np.int64))
        self._count += len(now)

    def mesh(self) -> meshio.Mesh:
        """All parts as one mesh."""
        now, rest = np.concatenate(self._now), np.concatenate(self._rest)
        return meshio.Mesh(now, self._cells, point_data={"displacement": now - rest},
                           cell_data={"part": self._part_of_cells})


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
    parts, model = _Parts(), simulation.model
    now, rest = simulation.state.positions, model.nodes.rest_positions
    for body in model.bodies:
        nodes = body.shown_nodes(np.arange(_point_count(body)))
        parts.add(body.name, nodes.positions(now), nodes.positions(rest), _cells(body))
    for beam in model.beams:
        nodes = beam.nodes_mapping()
        lines = np.column_stack([np.arange(beam.node_count - 1), np.arange(1, beam.node_count)])
        parts.add(beam.name, nodes.positions(now), nodes.positions(rest), [("line", lines)])
    for skin, here, there in zip(
        simulation.rigid_skins(), _frames(simulation, now), _frames(simulation, rest), strict=True
    ):
        triangles = [("triangle", skin.triangles)]
        parts.add(skin.name, _placed(skin.points, *here), _placed(skin.points, *there), triangles)
    first = sum(body.scene_node_count for body in model.bodies)
    for entry in simulation.scene.mass_springs:
        own = slice(first, first + len(entry.points))
        first += len(entry.points)
        springs = [("line", np.array(entry.springs, np.int64))] if entry.springs else []
        vertices = ("vertex", np.arange(len(entry.points))[:, None])
        parts.add(entry.name, now[own], rest[own], [vertices, *springs])
    at_rest = model.actuators.paths(rest)
    for name, points in simulation.actuator_paths().items():
        if len(points) == len(at_rest[name]) > 1:
            lines = np.column_stack([np.arange(len(points) - 1), np.arange(1, len(points))])
            parts.add(name, points, at_rest[name], [("line", lines)])
    mesh = parts.mesh()
    try:
        with output_file(path) as partial:
            meshio.write(partial, mesh)
    except (meshio.WriteError, meshio.ReadError, KeyError) as error:
        suffix = Path(path).suffix
        reason = f"meshio cannot write {suffix}" if suffix else "needs a suffix, such as .vtu"
        raise OutputError(path, reason) from error
    return tuple(parts.names)


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


def _placed(points: np.ndarray, origin: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    placed: np.ndarray = origin + points @ rotation.T
    return placed
