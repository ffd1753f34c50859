"""A body built from its scene entry: mesh, fixed nodes, carried points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from importlib import import_module

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.geometry.reading import MeshReading, read_tet_mesh
from softrobot_twin.geometry.regions import nodes_in_box, nodes_in_sphere
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene.schema import Region, Scene

# A point off the body by more than this share of the body's size is refused, by less is snapped.
SNAP_SHARE = 0.02
# A point off the body by less than this [m] is on it.
ON_BODY = 1.0e-6
# Sampling points between the middle of a ball and its rim.
BALL_STEPS = 3


@dataclass(frozen=True)
class Body:
    """A deformable body, placed and held.

    Attributes:
        mesh: The body at rest; where the scene asks for quadratic elements, a `QuadraticMesh`,
            which reads like a `TetMesh`.
        free_nodes: Nodes that move, shape (free_node_count,).
        free_index: Place of each node among them, -1 where fixed, shape (node_count,).
        size: Diagonal of its bounding box [m].
    """

    mesh: TetMesh
    free_nodes: np.ndarray
    free_index: np.ndarray
    size: float


def build_body(scene: Scene, notes: list[str]) -> Body:
    """Read the mesh and fix its nodes.

    Args:
        scene: The scene.
        notes: Takes what the reader mended.

    Returns:
        The body.

    Raises:
        MeshError: The mesh cannot be used.
        SceneError: A region holds no node, or the body is not held.
    """
    entry = scene.body.mesh
    reading = read_tet_mesh(
        scene.mesh_path, scale=entry.scale, translation=entry.translation, rotation=entry.rotation
    )
    notes.extend(reading.notes)
    mesh = _with_nodes_of(scene.body.element, reading.mesh)
    fixed = np.zeros(mesh.node_count, dtype=bool)
    for index, region in enumerate(scene.body.fixed):
        nodes = _nodes_in(region, mesh, reading, scene, f"body.fixed[{index}]")
        fixed[nodes] = True
    # An edge that is held at both ends is held in the middle too.
    fixed[reading.mesh.node_count :] |= fixed[mesh.mid_edge_ends].all(axis=1)
    _check_held(mesh, fixed, scene)
    free_nodes = np.flatnonzero(~fixed)
    free_index = np.full(mesh.node_count, -1, dtype=np.int64)
    free_index[free_nodes] = np.arange(len(free_nodes))
    low, high = mesh.bounding_box
    return Body(mesh, free_nodes, free_index, float(np.linalg.norm(high - low)))


def _with_nodes_of(element: str, mesh: TetMesh):
    """The mesh with the nodes that an element needs beyond its corners."""
    if element == "linear":
        return mesh
    return import_module("softrobot_twin.geometry.quadratic").add_mid_edge_nodes(mesh)


def carry(
    body: Body, points, key: str, scene: Scene, notes: list[str], spread_radius: float = 0.0
) -> BarycentricMapping:
    """Map points onto the body.

    Args:
        body: The body.
        points: Points at rest [m], shape (point_count, 3).
        key: Scene entry the points come from, to name in errors.
        scene: The scene.
        notes: Takes a warning for each point that had to be snapped.
        spread_radius: Each point moves as the mean of the body within this radius of it [m].

    Returns:
        The mapping; with a radius its points lie at the means.

    Raises:
        SceneError: A point is too far from the body.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    found = locate_points(body.mesh.corner_mesh, points)
    for index, distance in enumerate(found.distances):
        place = f"{key}[{index}]"
        stated = "[" + ", ".join(f"{value:g}" for value in points[index]) + "]"
        if distance > SNAP_SHARE * body.size:
            raise SceneError(
                scene.path, place, stated, "m",
                f"lies {1e3 * distance:.2f} mm outside the body; points must be on it "
                f"(within {1e3 * SNAP_SHARE * body.size:.2f} mm they are snapped to its surface)",
            )  # fmt: skip
        if distance > ON_BODY:
            notes.append(
                f"{place} = {stated} m lies {1e3 * distance:.3f} mm outside the body: "
                "snapped to its surface"
            )
    if spread_radius > 0.0:
        return _spread(body, points, spread_radius)
    return BarycentricMapping(*body.mesh.carriers(found.tets, found.barycentric_weights))


def _spread(body: Body, points: np.ndarray, radius: float) -> BarycentricMapping:
    """The mean of a ball about each point, as far as the ball lies in the body.

    The ball is the same whatever the mesh, so what pulls there has a limit under refinement.
    """
    line = np.arange(-BALL_STEPS, BALL_STEPS + 1) / BALL_STEPS
    cube = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = radius * cube[np.linalg.norm(cube, axis=1) <= 1.0 + 1.0e-9]
    spread = []
    for point in points:
        found = locate_points(body.mesh.corner_mesh, point + ball)
        inside = found.distances <= ON_BODY
        # A point that was snapped to the body may have no ball in it: it stays a point.
        kept = inside if inside.any() else np.linalg.norm(ball, axis=1) == 0.0
        carriers = body.mesh.carriers(found.tets[kept], found.barycentric_weights[kept])
        spread.append(BarycentricMapping(*carriers).mean())
    return reduce(BarycentricMapping.followed_by, spread)


def _nodes_in(
    region: Region, mesh, reading: MeshReading, scene: Scene, key: str
) -> np.ndarray:
    positions = mesh.node_positions
    if region.box is not None:
        nodes = nodes_in_box(positions, region.box.minimum, region.box.maximum)
        value, unit = f"{list(region.box.minimum)}..{list(region.box.maximum)}", "m"
    elif region.sphere is not None:
        nodes = nodes_in_sphere(positions, region.sphere.centre, region.sphere.radius)
        value, unit = f"{list(region.sphere.centre)}, radius {region.sphere.radius}", "m"
    else:
        asked = np.asarray(region.nodes, dtype=np.int64)
        value, unit = f"{len(asked)} nodes", ""
        beyond = asked[asked >= len(reading.mesh_node_indices)]
        if len(beyond):
            raise SceneError(
                scene.path, f"{key}.nodes", int(beyond[0]), "",
                f"the mesh file has nodes 0 to {len(reading.mesh_node_indices) - 1}",
            )  # fmt: skip
        nodes = reading.mesh_node_indices[asked]
        nodes = nodes[nodes >= 0]
    if len(nodes) == 0:
        low, high = mesh.bounding_box
        raise SceneError(
            scene.path, key, value, unit,
            f"holds no node of the body, which reaches from {low.tolist()} to {high.tolist()} m",
        )  # fmt: skip
    return nodes


def _check_held(mesh, fixed: np.ndarray, scene: Scene) -> None:
    """Every piece needs three fixed nodes that are not on one line, or it would float or swing."""
    first, others = mesh.tets[:, :1], mesh.tets[:, 1:]
    graph = coo_array(
        (np.ones(others.size), (np.broadcast_to(first, others.shape).ravel(), others.ravel())),
        shape=(mesh.node_count, mesh.node_count),
    )
    piece_count, piece = connected_components(graph, directed=False)
    for index in range(piece_count):
        held = mesh.node_positions[fixed & (piece == index)]
        spread = np.linalg.svd(held - held.mean(axis=0), compute_uv=False) if len(held) else []
        if len(held) < 3 or spread[1] <= 1.0e-9 * max(spread[0], 1.0e-300):
            which = "the body" if piece_count == 1 else f"piece {index} of {piece_count}"
            raise SceneError(
                scene.path, "body.fixed", f"{len(held)} nodes", "",
                f"{which} is not held: in quasi_static integration at least three nodes that are "
                "not on one line must be fixed, or the body floats away",
            )  # fmt: skip
