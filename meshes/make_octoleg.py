"""Makes the tetrahedral meshes of the Octoleg: ``python meshes/make_octoleg.py``.

The Octoleg is a tentacle in the x–z plane that tapers from its root, at the upper left, to its
tip, at the lower right. Seven notches open on its inner side, towards −x and −z, and leave hinges
6 to 4 mm thick at the back. The cable crosses each in the open, from one flank to the other, so
winding it in closes the notches and curls the tentacle inwards, until flank meets flank. The
inner side is a keel: a flank is a triangle whose tip, the first to touch, comes to lie on the
other flank. The script prints these pairs.

Sections of one layout stand at the root, at every flank and along the tip; what lies between two
of them is made of prisms, three tetrahedra each. The coarsest mesh has one prism between the
sections; the finer ones cut them and the section's triangles.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np

# The script also runs from a checkout that is not installed.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from meshes.mesh_making import faults_of, make_all, mesh_parser  # noqa: E402
from meshes.octoleg_shape import (  # noqa: E402
    BACK_LEFT,
    BACK_RIGHT,
    CABLE_POINTS,
    FLOOR_LEFT,
    FLOOR_RIGHT,
    KEEL,
    OctolegShape,
    contact_pairs,
    sections,
)
from softrobot_twin.geometry.quality import radius_ratios  # noqa: E402
from softrobot_twin.geometry.tet_mesh import TetMesh  # noqa: E402

LOWEST_RADIUS_RATIO = 0.1
# A section's nodes as weights of its corners: these, and the middle of the back.
LAYOUT = np.vstack([np.eye(5), [0.5, 0.5, 0.0, 0.0, 0.0]])
BACK_MIDDLE = 5
BACK_TRIANGLES = np.array(
    [
        (BACK_LEFT, BACK_MIDDLE, FLOOR_LEFT),
        (BACK_MIDDLE, FLOOR_RIGHT, FLOOR_LEFT),
        (BACK_MIDDLE, BACK_RIGHT, FLOOR_RIGHT),
    ]
)
KEEL_TRIANGLES = np.array([(FLOOR_LEFT, FLOOR_RIGHT, KEEL)])


@dataclass(frozen=True)
class Refinement:
    """Numbers and lengths of the prisms of a mesh.

    Attributes:
        section_cuts: How often the section's triangles are cut into four.
        length: Longest prism [m].
        hinge_cells: Prisms along the back of a notch.
    """

    section_cuts: int
    length: float
    hinge_cells: int


# Name of a refinement (about its number of nodes) and how it is cut.
REFINEMENTS = {
    120: Refinement(0, 30e-3, 1),
    173: Refinement(0, 15e-3, 2),
    400: Refinement(1, 11e-3, 1),
    1000: Refinement(1, 3.2e-3, 2),
}


def make_octoleg(refinement: Refinement, shape: OctolegShape = OctolegShape()) -> TetMesh:
    """Meshes the Octoleg.

    Args:
        refinement: The refinement.
        shape: Dimensions of the body.

    Returns:
        The mesh [m].
    """
    layout, back, keel = LAYOUT, BACK_TRIANGLES, KEEL_TRIANGLES
    for _ in range(refinement.section_cuts):
        layout, cut = _cut_in_four(layout, np.vstack([back, keel]))
        back, keel = cut[: 4 * len(back)], cut[4 * len(back) :]
    corners, in_notch = _cut_along(refinement, *sections(shape))
    positions = 1e-3 * np.einsum("nc,scx->snx", layout, corners)
    tets = []
    for number, notch in enumerate(in_notch):
        triangles = back if notch else np.vstack([back, keel])
        tets.append(_best_prism_tets(positions[number : number + 2], triangles, number))
        tets[-1] += number * len(layout)
    tets = np.vstack(tets)
    used, indices = np.unique(tets, return_inverse=True)
    return TetMesh(positions.reshape(-1, 3)[used], indices.reshape(tets.shape))


def _cut_in_four(layout: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The layout with midpoints of edges added, and four triangles in place of each."""
    edges = np.sort(triangles[:, [(0, 1), (1, 2), (2, 0)]].reshape(-1, 2), axis=1)
    edges, middle = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = len(layout) + middle.reshape(-1, 3).T
    a, b, c = triangles.T
    cut = np.stack([(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]).transpose(2, 0, 1)
    return np.vstack([layout, layout[edges].mean(axis=1)]), cut.reshape(-1, 3)


def _cut_along(
    refinement: Refinement, corners: np.ndarray, in_notch: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Adds sections between the shared ones."""
    cut, notches = [corners[:1]], []
    for start, end, notch in zip(corners[:-1], corners[1:], in_notch, strict=True):
        length = 1e-3 * np.linalg.norm(end.mean(axis=0) - start.mean(axis=0))
        count = refinement.hinge_cells if notch else int(np.ceil(length / refinement.length))
        parts = np.linspace(0.0, 1.0, count + 1)[1:, None, None]
        cut.append((1.0 - parts) * start + parts * end)
        notches += [notch] * count
    return np.concatenate(cut), np.array(notches)


def _best_prism_tets(pair: np.ndarray, triangles: np.ndarray, number: int) -> np.ndarray:
    """Three tetrahedra in each prism between two sections, by the best of eight orders.

    A prism's diagonals go from the lower-ranked node of the first section to the higher-ranked
    one of the second. Nodes are ranked by height and by distance from the plane y = 0, so that the
    mesh is symmetric; only for a node and its mirror image on one edge the order alternates.

    Args:
        pair: Nodes of both sections [m], shape (2, layout_count, 3).
        triangles: Nodes of the section's triangles, shape (triangle_count, 3).
        number: Index of the first section.

    Returns:
        Indices into the nodes of both sections, shape (3 · triangle_count, 4).
    """
    points = pair.reshape(-1, 3)
    count = len(pair[0])
    middle = pair.mean(axis=0)
    inward = middle[KEEL] - middle[BACK_MIDDLE]
    depth = np.round((middle - middle[BACK_MIDDLE]) @ inward / np.dot(inward, inward), 9)
    aside = np.round(np.abs(middle[:, 1]), 9)
    # Alternate by pairs, because notches and solid parts alternate too.
    turn = middle[:, 1] * (-1.0) ** (number // 2)
    best, best_ratio = None, -1.0
    for first, second, depth_first in product((1, -1), (1, -1), (True, False)):
        keys = (first * depth, second * aside)
        order = np.lexsort((turn, *(keys[::-1] if depth_first else keys)))
        rank = np.empty(count, dtype=np.int64)
        rank[order] = np.arange(count)
        low, mid, high = np.take_along_axis(triangles, rank[triangles].argsort(axis=1), 1).T
        tets = np.concatenate(
            [
                np.stack([low, mid, high, high + count], axis=1),
                np.stack([low, mid, mid + count, high + count], axis=1),
                np.stack([low, low + count, mid + count, high + count], axis=1),
            ]
        )
        edges = points[tets[:, 1:]] - points[tets[:, :1]]
        negative = np.linalg.det(edges) < 0.0
        tets[negative] = tets[negative][:, [0, 1, 3, 2]]
        if np.linalg.det(points[tets[:, 1:]] - points[tets[:, :1]]).min() <= 0.0:
            continue
        ratio = radius_ratios(TetMesh(points, tets)).min()
        if ratio > best_ratio:
            best, best_ratio = tets, ratio
    return best


def _faults(mesh: TetMesh) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences."""
    return faults_of(mesh, np.insert(CABLE_POINTS, 1, 0.0, axis=1), LOWEST_RADIUS_RATIO)


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 1 when one of them cannot be used."""
    parser = mesh_parser("Mesh the Octoleg.", REFINEMENTS)
    options = parser.parse_args(arguments)
    made = make_all(options, "octoleg", REFINEMENTS, make_octoleg, _faults)
    print("Self-contacts, a point and the triangle on the other flank [mm]:")
    for point, *triangle in 1e3 * contact_pairs():
        corners = " ".join(f"({x:.2f}, {y:.2f}, {z:.2f})" for x, y, z in triangle)
        print(f"  ({point[0]:.2f}, {point[1]:.2f}, {point[2]:.2f}) on {corners}")
    return 0 if made else 1


if __name__ == "__main__":
    sys.exit(main())
