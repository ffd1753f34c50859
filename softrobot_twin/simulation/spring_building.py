"""Springs of a scene: between points, along paths, and in mass-spring bodies."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.springs import Springs, springs_along
from softrobot_twin.simulation.held_masses import check_held
from softrobot_twin.simulation.layout import Layout

# A mass-spring body's end must be this near to one of its points [m].
AT_POINT = 1.0e-6


def spring_terms(layout: Layout, notes: list[str]) -> Iterator[Springs]:
    """All springs of a scene.

    Args:
        layout: The bodies.
        notes: Takes a warning for each point that had to be snapped.

    Yields:
        Force terms.

    Raises:
        SceneError: A point does not lie on its body, or a point mass floats in statics.
    """
    scene, nodes = layout.scene, layout.nodes
    frames = getattr(nodes, "frames", None)
    if scene.mass_springs and scene.integration == "quasi_static":
        check_held(layout, [_point_masses(layout, spring) for spring in scene.springs])
    for index, spring in enumerate(scene.springs):
        yield _between(layout, spring, f"springs[{index}]", notes)
    for index, tube in enumerate(scene.tubes):
        path = layout.carried(tube.on, tube.points, f"tubes[{index}].points", notes)
        yield springs_along(
            path, tube.axial_stiffness, nodes.rest_positions, nodes.free_index, frames
        )
    for entry in scene.mass_springs:
        if entry.springs:
            yield _in_mass_spring_body(layout, entry)


def _between(layout: Layout, spring, key: str, notes: list[str]) -> Springs:
    nodes = layout.nodes
    ends = spring.ends if spring.ends[0].on != "world" else spring.ends[::-1]
    if ends[0].on == "world":
        raise SceneError(
            layout.scene.path, f"{key}.ends", "world", "", "both ends stand in the world"
        )
    first = _end(layout, ends[0], f"{key}.ends", notes)
    rest = np.linalg.norm(np.subtract(ends[1].point, ends[0].point))
    length = rest if spring.rest_length is None else spring.rest_length
    second, offsets = None, None
    if ends[1].on == "world":
        offsets = np.array([ends[1].point])
    else:
        second = _end(layout, ends[1], f"{key}.ends", notes)
    return Springs(
        first, second, np.array([spring.stiffness]), np.array([length]),
        np.array([spring.damping]), nodes.free_index, getattr(nodes, "frames", None), offsets,
    )  # fmt: skip


def _point_masses(layout: Layout, spring) -> tuple[int, int]:
    """Nodes of the point masses at a spring's ends, -1 where an end is elsewhere."""
    found = []
    for end in spring.ends:
        own = layout.mass_nodes.get(end.on)
        if own is not None:
            distances = np.linalg.norm(layout.nodes.rest_positions[own] - end.point, axis=1)
        found.append(-1 if own is None else int(own[distances.argmin()]))
    return found[0], found[1]


def _end(layout: Layout, end, key: str, notes: list[str]) -> BarycentricMapping:
    if end.on not in layout.mass_nodes:
        return layout.carried(end.on, [end.point], key, notes)
    own = layout.mass_nodes[end.on]
    distances = np.linalg.norm(layout.nodes.rest_positions[own] - end.point, axis=1)
    if distances.min() > AT_POINT:
        raise SceneError(
            layout.scene.path, key, list(end.point), "m",
            f"is not a point of {end.on}; the nearest is {distances.min():.3g} m away",
        )  # fmt: skip
    return BarycentricMapping(own[[[distances.argmin()]]], np.ones((1, 1)))


def _in_mass_spring_body(layout: Layout, entry) -> Springs:
    nodes = layout.nodes
    pairs = layout.mass_nodes[entry.name][np.array(entry.springs, np.int64)]
    first, second = (BarycentricMapping(pairs[:, [k]], np.ones((len(pairs), 1))) for k in (0, 1))
    ways = nodes.rest_positions[pairs[:, 1]] - nodes.rest_positions[pairs[:, 0]]
    count = len(pairs)
    return Springs(
        first, second, np.full(count, entry.stiffness), np.linalg.norm(ways, axis=1),
        np.full(count, entry.damping), nodes.free_index, getattr(nodes, "frames", None),
    )  # fmt: skip
