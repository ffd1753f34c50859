"""Bodies swept from a plane section, with the cavities in them.

A section of quadrilaterals and triangles is repeated at several levels. Each face of it and each
gap between two levels make a cell: a brick or a prism. A cell belongs to a region of the body, is
filled with the gas of a cavity, or is empty. The gas is meshed like the body and then left out:
its surface is the cavity's, closed, on nodes of the body, with normals out of the gas.

The nodes of the bricks are chequered: neighbours have different colours, in the section and along
the sweep. A brick becomes five tetrahedra, a prism three; the diagonal of each face leaves its
lowest-ranked node, so neighbours agree, and the mesh has every symmetry that the ranks have.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from meshes.mesh_making import PneumaticMesh, oriented_tets
from softrobot_twin.geometry.surface import boundary_triangles
from softrobot_twin.geometry.tet_mesh import TetMesh

EMPTY = ""
"""Label of a cell where there is neither body nor gas."""
CAVITY = "cavity"
"""Beginning of the label of a cell that is filled with gas."""
# Rank of a node of no brick, at least; 0 and 1 are the colours of chequered nodes.
UNCOLOURED = 2

# A brick's corners 0 to 3 lie below 4 to 7. For either colour of corner 0: the tetrahedra that cut
# its diagonals through the corners of the lower rank.
_BRICK_TETS = {
    (0, 2, 5, 7): ((0, 2, 5, 7), (1, 0, 2, 5), (3, 0, 2, 7), (4, 0, 5, 7), (6, 2, 5, 7)),
    (1, 3, 4, 6): ((1, 3, 4, 6), (0, 1, 3, 4), (2, 1, 3, 6), (5, 1, 4, 6), (7, 3, 4, 6)),
}
# A prism's corners 0 to 2 lie below 3 to 5.
_PRISM_FACES = ((0, 1, 2), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))


class Section(NamedTuple):
    """A plane section.

    Attributes:
        points: Its nodes [mm], shape (point_count, 2).
        faces: Quadrilaterals, counter-clockwise; a triangle repeats its last corner; shape
            (face_count, 4).
        ranks: Colour 0 or 1 of each node of a quadrilateral; from `UNCOLOURED` on any order of the
            others, in which neighbours differ; shape (point_count,).
    """

    points: np.ndarray
    faces: np.ndarray
    ranks: np.ndarray


def ruled_quads(first: np.ndarray, second: np.ndarray, cell_count: int) -> np.ndarray:
    """Quadrilaterals between two lines.

    Args:
        first: Points of one line [mm], shape (count, 2).
        second: Points of the other, on the left of the first, shape (count, 2).
        cell_count: Quadrilaterals from the first line to the second.

    Returns:
        Corners of the quadrilaterals, from line to line, shape (cell_count · (count − 1), 4, 2).
    """
    shares = np.linspace(0.0, 1.0, cell_count + 1)[:, None, None]
    grid = (1.0 - shares) * first + shares * second
    quads = np.stack([grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]], axis=2)
    return quads.reshape(-1, 4, 2)


def joined(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [mm] and faces of a section, by the corners of its faces, shape (face_count, 4, 2)."""
    # To 1 nm: corners that coincide but for round-off become one node, at rounded coordinates.
    points, faces = np.unique(
        np.round(corners.reshape(-1, 2), 6) + 0.0, axis=0, return_inverse=True
    )
    return points, faces.reshape(-1, 4)


def chequered(points: np.ndarray, quads: np.ndarray) -> Section:
    """Section of quadrilaterals, its nodes coloured from neighbour to neighbour."""
    ranks = np.full(len(points), UNCOLOURED)
    ranks[0], reached = 0, True
    while reached:
        reached = False
        for quad in quads:
            known = [corner for corner in range(4) if ranks[quad[corner]] < UNCOLOURED]
            if 0 < len(known) < 4:
                colour = (ranks[quad[known[0]]] + known[0]) % 2
                ranks[quad] = (colour + np.arange(4)) % 2
                reached = True
    return Section(points, quads, ranks)


def rounding_factor(sectors: int) -> float:
    """Circumradius of a regular polygon over the radius of the circle of the same area."""
    angle = 2.0 * np.pi / sectors
    return float(np.sqrt(angle / np.sin(angle)))


def polar_section(radii: np.ndarray, sectors: int) -> Section:
    """Disc of rings around a middle, whose polygons have the areas of the circles they replace.

    Args:
        radii: Radii of the rings [mm], shape (ring_count,).
        sectors: Nodes of each ring, an even number.

    Returns:
        The section: node 0 in the middle, then ring after ring; faces ring after ring.
    """
    angles = 2.0 * np.pi * np.arange(sectors) / sectors
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    rings = rounding_factor(sectors) * np.asarray(radii)[:, None, None] * directions
    number = 1 + np.arange(len(radii) * sectors).reshape(len(radii), sectors)
    ahead = np.roll(number, -1, axis=1)
    middle = np.zeros(sectors, dtype=np.int64)
    triangles = np.stack([middle, number[0], ahead[0], ahead[0]], axis=1)
    quads = np.stack([number[:-1], number[1:], ahead[1:], ahead[:-1]], axis=-1).reshape(-1, 4)
    colours = (np.arange(len(radii))[:, None] + np.arange(sectors)) % 2
    return Section(
        np.vstack([np.zeros((1, 2)), rings.reshape(-1, 2)]),
        np.vstack([triangles, quads]),
        np.concatenate([[UNCOLOURED], colours.ravel()]),
    )


def swept(
    section: Section, heights: np.ndarray, labels: np.ndarray, whole: bool = False
) -> PneumaticMesh:
    """Sweeps a section along z.

    Args:
        section: The section.
        heights: z of each of its nodes at each level [mm], shape (level_count, point_count) or
            (level_count, 1).
        labels: Region or cavity of each cell, or `EMPTY`, shape (level_count − 1, face_count).
        whole: Whether its bricks are kept whole beside the tetrahedra.

    Returns:
        The body [m]; regions in alphabetical order.

    Raises:
        ValueError: The colours are not chequered, or gas touches no body.
    """
    level_count, point_count = len(heights), len(section.points)
    positions = np.empty((level_count, point_count, 3))
    positions[..., :2] = section.points
    positions[..., 2] = heights
    positions = 1e-3 * positions.reshape(-1, 3)
    levels = np.arange(level_count)[:, None]
    ranks = np.where(
        section.ranks < UNCOLOURED, (section.ranks + levels) % 2, 2 * section.ranks + levels % 2
    ).ravel()
    starts = point_count * np.arange(level_count - 1)[:, None, None]
    lower = (section.faces + starts).reshape(-1, 4)
    cells = np.hstack([lower, lower + point_count])
    tets = {
        str(label): oriented_tets(positions, _divided(cells[labels.ravel() == label], ranks))
        for label in np.unique(labels)
        if label != EMPTY
    }
    bricks = {label: cells[labels.ravel() == label] for label in tets} if whole else {}
    return _without_gas(positions, tets, bricks)


def _without_gas(
    positions: np.ndarray, tets: dict[str, np.ndarray], bricks: dict[str, np.ndarray]
) -> PneumaticMesh:
    """The body, and the surfaces of the gas."""
    solid = {label: cells for label, cells in tets.items() if not label.startswith(CAVITY)}
    used, indices = np.unique(np.vstack(list(solid.values())), return_inverse=True)
    ends = np.cumsum([len(cells) for cells in solid.values()])
    regions = {
        label: np.arange(end - len(cells), end)
        for (label, cells), end in zip(solid.items(), ends, strict=True)
    }
    new_indices = np.full(len(positions), -1)
    new_indices[used] = np.arange(len(used))
    cavities = {
        label: new_indices[boundary_triangles(cells)]
        for label, cells in tets.items()
        if label.startswith(CAVITY)
    }
    for label, triangles in cavities.items():
        if (triangles < 0).any():
            raise ValueError(f"the gas of {label} ends where there is no body")
    kept = {label: new_indices[bricks[label]] for label in solid if label in bricks}
    return PneumaticMesh(TetMesh(positions[used], indices.reshape(-1, 4)), regions, cavities, kept)


def _divided(cells: np.ndarray, ranks: np.ndarray) -> np.ndarray:
    """Tetrahedra of bricks and prisms.

    Args:
        cells: Corners below, then above; a prism repeats its third; shape (cell_count, 8).
        ranks: Rank of each node.

    Returns:
        Node indices of the tetrahedra, shape (tet_count, 4).
    """
    is_prism = cells[:, 2] == cells[:, 3]
    bricks = cells[~is_prism]
    low = ranks[bricks] == 0
    tets = []
    chequered_count = 0
    for corners, pattern in _BRICK_TETS.items():
        alike = (low == np.isin(np.arange(8), corners)).all(axis=1)
        chequered_count += np.count_nonzero(alike)
        tets.append(bricks[alike][:, np.array(pattern)].reshape(-1, 4))
    if chequered_count != len(bricks) or (ranks[bricks] >= UNCOLOURED).any():
        raise ValueError("the nodes of a brick are not chequered")
    for prism in cells[is_prism][:, [0, 1, 2, 4, 5, 6]]:
        tets.append(prism[_prism_tets(tuple(ranks[prism]))])
    return np.vstack(tets)


def _prism_tets(ranks: tuple[int, ...]) -> np.ndarray:
    """Corners of the tetrahedra from a prism's lowest-ranked corner to the faces beyond it."""
    apex = int(np.argmin(ranks))
    tets = []
    for face in _PRISM_FACES:
        lowest = min(face, key=lambda corner: ranks[corner])
        place = face.index(lowest)
        a, b, *beyond = face[place:] + face[:place]
        if len(face) == 4 and ranks[lowest] in (ranks[b], ranks[beyond[-1]]):
            raise ValueError("neighbours on a prism have the same rank")
        if apex not in face:
            tets += [(apex, a, left, right) for left, right in zip((b, *beyond), beyond)]
    return np.array(tets)
