"""Springs of a scene: between points, along paths, and in mass-spring bodies."""

from __future__ import annotations

from functools import reduce
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SceneError
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.mechanics.springs import Springs, stretches
from softrobot_twin.simulation.layout import Layout

# A mass-spring body's end must be this near to one of its points [m].
AT_POINT = 1.0e-6


class _Part(NamedTuple):
    """Some springs of one kind; see `Springs` for the fields."""

    first: BarycentricMapping
    second: BarycentricMapping
    stiffness: np.ndarray
    rest_lengths: np.ndarray
    damping: np.ndarray
    offsets: np.ndarray


def spring_term(layout: Layout, notes: list[str]) -> Springs:
    """All springs of a scene, in one term: a call for each tube would cost more than its springs.

    Args:
        layout: The bodies.
        notes: Takes a warning for each point that had to be snapped.

    Returns:
        The force term.

    Raises:
        SceneError: A point does not lie on its body.
    """
    scene, nodes = layout.scene, layout.nodes
    parts = [_between(layout, s, f"springs[{i}]", notes) for i, s in enumerate(scene.springs)]
    for index, tube in enumerate(scene.tubes):
        path = layout.carried(tube.on, tube.points, f"tubes[{index}].points", notes)
        first, second, lengths = stretches(path, nodes.rest_positions)
        none = np.zeros(len(lengths))
        parts.append(
            _Part(first, second, tube.axial_stiffness / lengths, lengths, none,
                  np.zeros((len(lengths), 3)))
        )  # fmt: skip
    parts += [_in_mass_spring_body(layout, entry) for entry in scene.mass_springs if entry.springs]
    firsts, seconds, *columns, offsets = zip(*parts, strict=True)
    return Springs(
        reduce(BarycentricMapping.followed_by, firsts),
        reduce(BarycentricMapping.followed_by, seconds),
        *(np.concatenate(column) for column in columns), nodes.free_index,
        getattr(nodes, "frames", None), np.concatenate(offsets),
    )  # fmt: skip


def _between(layout: Layout, spring, key: str, notes: list[str]) -> _Part:
    ends = spring.ends if spring.ends[0].on != "world" else spring.ends[::-1]
    if ends[0].on == "world":
        raise SceneError(
            layout.scene.path, f"{key}.ends", "world", "", "both ends stand in the world"
        )
    first = _end(layout, ends[0], f"{key}.ends", notes)
    rest = np.linalg.norm(np.subtract(ends[1].point, ends[0].point))
    length = rest if spring.rest_length is None else spring.rest_length
    if ends[1].on == "world":
        second = BarycentricMapping(np.zeros((1, 1), np.int64), np.zeros((1, 1)))
        offset = np.array([ends[1].point], float)
    else:
        second, offset = _end(layout, ends[1], f"{key}.ends", notes), np.zeros((1, 3))
    return _Part(
        first, second, np.array([spring.stiffness]), np.array([length]),
        np.array([spring.damping]), offset,
    )  # fmt: skip


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


def _in_mass_spring_body(layout: Layout, entry) -> _Part:
    rest = layout.nodes.rest_positions
    pairs = layout.mass_nodes[entry.name][np.array(entry.springs, np.int64)]
    first, second = (BarycentricMapping(pairs[:, [k]], np.ones((len(pairs), 1))) for k in (0, 1))
    lengths = np.linalg.norm(rest[pairs[:, 1]] - rest[pairs[:, 0]], axis=1)
    count = len(pairs)
    return _Part(
        first, second, np.full(count, entry.stiffness), lengths,
        np.full(count, entry.damping), np.zeros((count, 3)),
    )  # fmt: skip
