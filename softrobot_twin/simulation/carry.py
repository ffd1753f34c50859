"""Points carried by a body: found in its elements at rest, snapped where they lie just outside."""

from __future__ import annotations

from functools import reduce

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.body import Body, size_hint

# A point off the body by more than this share of the body's size is refused, by less is snapped.
SNAP_SHARE = 0.02
# A point off the body by less than this share of its size is on it.
ON_BODY = 5.0e-6
# A carried surface may stand off its body by this share of the body's size, and no more; and it is
# not smaller than this share of it.
STAND_OFF, LEAST_SHARE = 0.1, 0.5
# Sampling points between the middle of a ball and its rim.
BALL_STEPS = 3


def carry(
    body: Body, points, key: str, scene: Scene, notes: list[str], spread_radius: float = 0.0
) -> BarycentricMapping:
    """Map points onto the body.

    Args:
        body: The body.
        points: Points at rest [m], shape (point_count, 3).
        key: Scene entry the points come from, to name in errors.
        scene: The scene.
        notes: Takes one warning for all points that had to be snapped.
        spread_radius: Each point moves as the mean of the body within this radius of it [m].

    Returns:
        The mapping; with a radius its points lie at the means.

    Raises:
        SceneError: A point is too far from the body.
    """
    points = np.asarray(points, dtype=float).reshape(-1, 3)
    found = locate_points(body.mesh.corner_mesh, points)
    snapped = []
    for index, distance in enumerate(found.distances):
        place = f"{key}[{index}]"
        stated = "[" + ", ".join(f"{value:g}" for value in points[index]) + "]"
        if distance > SNAP_SHARE * body.size:
            raise SceneError(
                scene.path, place, stated, "m",
                f"lies {1e3 * distance:.2f} mm outside the body; points must be on it "
                f"(within {1e3 * SNAP_SHARE * body.size:.2f} mm they are snapped to its surface)"
                + size_hint(body.size),
            )  # fmt: skip
        if distance > ON_BODY * body.size:
            snapped.append((distance, f"{place} = {stated} m"))
    if len(snapped) == 1:
        ((distance, place),) = snapped
        notes.append(
            f"{place} lies {1e3 * distance:.3f} mm outside the body: snapped to its surface"
        )
    elif snapped:
        distance, place = max(snapped)
        notes.append(
            f"{key}: {len(snapped)} of {len(points)} points lie outside the body: snapped to its "
            f"surface; the furthest is {place}, {1e3 * distance:.3f} mm outside"
        )
    if spread_radius > 0.0:
        return _spread(body, points, spread_radius)
    return body.mapping(found.tets, found.barycentric_weights)


def carry_surface(
    body: Body, points: np.ndarray, entry, key: str, scene: Scene
) -> BarycentricMapping:
    """Map the points of a surface onto the body that carries it.

    A point outside the mesh is carried by the nearest tetrahedron, with weights below zero: at rest
    it stays where it is, and it turns with that tetrahedron.

    Args:
        body: The body.
        points: Points at rest [m], shape (point_count, 3).
        entry: What names the surface's file.
        key: Where it does.
        scene: The scene.

    Returns:
        The mapping.

    Raises:
        SceneError: The surface stands too far off the body, or is far smaller.
    """
    found = locate_points(body.mesh.corner_mesh, points)
    furthest = float(found.distances.max())
    if furthest > STAND_OFF * body.size:
        raise SceneError(
            scene.path, f"{key}.file", str(entry.file), "",
            f"stands off its body by {1e3 * furthest:.2f} mm, more than a tenth of the "
            f"body's {1e3 * body.size:.1f} mm: is its scale right?",
        )  # fmt: skip
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    if size < LEAST_SHARE * body.size:
        raise SceneError(
            scene.path, f"{key}.file", str(entry.file), "",
            f"has a box of {1e3 * size:.3g} mm across, less than half of the body's "
            f"{1e3 * body.size:.1f} mm: is its scale right?",
        )  # fmt: skip
    corners = body.mesh.corner_mesh.node_positions[body.mesh.corner_mesh.cells[found.tets]]
    return body.mapping(found.tets, barycentric_weights(corners, points))


def barycentric_weights(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Weights of points in tetrahedra, also of points outside.

    Args:
        corners: Corners of the tetrahedron of each point [m], shape (point_count, 4, 3).
        points: The points [m], shape (point_count, 3).

    Returns:
        Weights, each row of sum 1, shape (point_count, 4).
    """
    edges = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
    last = np.linalg.solve(edges, (points - corners[:, 0])[..., None])[..., 0]
    return np.column_stack([1.0 - last.sum(axis=1), last])


def _spread(body: Body, points: np.ndarray, radius: float) -> BarycentricMapping:
    """The mean of a ball about each point, as far as the ball lies in the body.

    The ball is the same whatever the mesh, so what pulls there has a limit under refinement.
    """
    line = np.arange(-BALL_STEPS, BALL_STEPS + 1) / BALL_STEPS
    cube = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = radius * cube[np.linalg.norm(cube, axis=1) <= 1.0 + 1.0e-9]
    found = locate_points(body.mesh.corner_mesh, (points[:, None] + ball).reshape(-1, 3))
    inside = (found.distances <= ON_BODY * body.size).reshape(len(points), -1)
    place = np.arange(found.tets.size).reshape(len(points), -1)
    # A point that was snapped to the body may have no ball in it: it stays a point.
    inside[~inside.any(axis=1)] = np.linalg.norm(ball, axis=1) == 0.0
    spread = [
        body.mapping(found.tets[own[kept]], found.barycentric_weights[own[kept]]).mean()
        for own, kept in zip(place, inside, strict=True)
    ]
    return reduce(BarycentricMapping.followed_by, spread)
