"""Whether springs hold every point mass, as statics needs it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation.layout import Layout


def check_masses_held(layout: Layout) -> None:
    """Refuse point masses that no chain of springs joins to anything that is held.

    Args:
        layout: The bodies; all but point masses are held in statics, or refused before.

    Raises:
        SceneError: A point mass floats.
    """
    world = len(layout.nodes.rest_positions)
    pairs = []
    for spring in layout.scene.springs:
        ends = (_point_mass(layout, end) for end in spring.ends)
        pairs.append(tuple(world if node is None else node for node in ends))
    for entry in layout.scene.mass_springs:
        nodes = layout.mass_nodes[entry.name]
        pairs += [(int(nodes[a]), int(nodes[b])) for a, b in entry.springs]
        pairs += [(int(nodes[k]), world) for k in entry.fixed]
    rows, columns = np.array(pairs, np.int64).reshape(-1, 2).T
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(world + 1, world + 1))
    _, piece = connected_components(graph, directed=False)
    for index, entry in enumerate(layout.scene.mass_springs):
        loose = np.flatnonzero(piece[layout.mass_nodes[entry.name]] != piece[world])
        if len(loose):
            raise SceneError(
                layout.scene.path, f"mass_springs[{index}]", f"point {loose[0]}", "",
                f"of {entry.name} floats: in quasi_static integration a chain of springs must "
                "join it to a fixed point or to a body that is held",
            )  # fmt: skip


def _point_mass(layout: Layout, end) -> int | None:
    """Node of the point mass that a spring's end holds; None where it holds something else."""
    if end.on not in layout.mass_nodes:
        return None
    own = layout.mass_nodes[end.on]
    rest = layout.nodes.rest_positions[own]
    return int(own[np.argmin(np.linalg.norm(rest - end.point, axis=1))])
