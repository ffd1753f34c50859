"""Points carried by a body: found in its elements at rest, snapped where they lie just outside."""

from __future__ import annotations

from functools import reduce

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.point_location import locate_points
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.body import Body

# A point off the body by more than this share of the body's size is refused, by less is snapped.
SNAP_SHARE = 0.02
# A point off the body by less than this [m] is on it.
ON_BODY = 1.0e-6
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
    return body.mapping(found.tets, found.barycentric_weights)


def _spread(body: Body, points: np.ndarray, radius: float) -> BarycentricMapping:
    """The mean of a ball about each point, as far as the ball lies in the body.

    The ball is the same whatever the mesh, so what pulls there has a limit under refinement.
    """
    line = np.arange(-BALL_STEPS, BALL_STEPS + 1) / BALL_STEPS
    cube = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    ball = radius * cube[np.linalg.norm(cube, axis=1) <= 1.0 + 1.0e-9]
    found = locate_points(body.mesh.corner_mesh, (points[:, None] + ball).reshape(-1, 3))
    inside = (found.distances <= ON_BODY).reshape(len(points), -1)
    place = np.arange(found.tets.size).reshape(len(points), -1)
    # A point that was snapped to the body may have no ball in it: it stays a point.
    inside[~inside.any(axis=1)] = np.linalg.norm(ball, axis=1) == 0.0
    spread = [
        body.mapping(found.tets[own[kept]], found.barycentric_weights[own[kept]]).mean()
        for own, kept in zip(place, inside, strict=True)
    ]
    return reduce(BarycentricMapping.followed_by, spread)
