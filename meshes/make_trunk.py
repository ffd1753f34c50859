"""Makes the tetrahedral meshes of the Trunk: ``python meshes/make_trunk.py``.

The Trunk is a tapering column of silicone along z: a core, and ten disks around it through which
the cables run. Between the disks the cables run outside the body. Every polygon has the area of the
circle that it replaces, so that all refinements have the same volume and, apart from the
discretization error, the same stiffness.

Sections of rings, six nodes more on each, stand at both faces of every disk; what lies between
two of them is made of prisms, three tetrahedra each. With ``--cables`` the script prints the
cables of a scene and the tubes around them.
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
from meshes.trunk_shape import DISK_COUNT, TrunkShape, cable_path, cables  # noqa: E402
from softrobot_twin.geometry.quality import radius_ratios  # noqa: E402
from softrobot_twin.geometry.tet_mesh import TetMesh  # noqa: E402

LOWEST_RADIUS_RATIO = 0.35


@dataclass(frozen=True)
class Refinement:
    """Numbers of rings and layers of a mesh.

    Attributes:
        core_rings: Rings of the core around its middle.
        disk_rings: Rings of a disk around the core.
        disk_cells: Layers of a disk.
        gap_cells: Layers between two disks.
        end_cells: Layers below the first disk, and above the last one.
        grows: Whether each ring of a disk has six nodes more than the one within it, as those of
            the core have; else as many as the core's outer ring.
    """

    core_rings: int
    disk_rings: int
    disk_cells: int
    gap_cells: int
    end_cells: tuple[int, int]
    grows: bool = True

    def ring_nodes(self) -> list[int]:
        """Nodes of each ring, from the middle on."""
        rings = range(1, self.core_rings + self.disk_rings + 1)
        return [1, *(6 * (ring if self.grows else min(ring, self.core_rings)) for ring in rings)]


# Name of a refinement (about its number of nodes) and how it is cut.
REFINEMENTS = {
    700: Refinement(1, 1, 2, 3, (2, 2)),
    900: Refinement(2, 1, 1, 2, (3, 2), grows=False),
    1600: Refinement(2, 1, 2, 3, (6, 3)),
    4000: Refinement(3, 2, 2, 4, (6, 4)),
}


def make_trunk(refinement: Refinement, shape: TrunkShape = TrunkShape()) -> TetMesh:
    """Meshes the Trunk.

    Args:
        refinement: The refinement.
        shape: Dimensions of the body.

    Returns:
        The mesh [m].
    """
    heights, in_disk = _layers(refinement, shape)
    core = refinement.core_rings
    nodes = refinement.ring_nodes()
    positions = 1e-3 * np.stack([_section(z, refinement, shape) for z in heights])
    triangles = _triangles(nodes)
    core_triangles = _triangles(nodes[: core + 1])
    tets = []
    for number, disk in enumerate(in_disk):
        pair = positions[number : number + 2]
        cut = _best_prism_tets(pair, triangles if disk else core_triangles, number)
        tets.append(cut + number * positions.shape[1])
    tets = np.vstack(tets)
    used, indices = np.unique(tets, return_inverse=True)
    return TetMesh(positions.reshape(-1, 3)[used], indices.reshape(tets.shape))


def _layers(refinement: Refinement, shape: TrunkShape) -> tuple[np.ndarray, np.ndarray]:
    """z of all sections [mm], and whether a disk lies between each two."""
    marks = np.concatenate([[0.0], shape.disk_faces().ravel(), [shape.length]])
    cells = np.full(len(marks) - 1, refinement.gap_cells)
    cells[1::2] = refinement.disk_cells
    cells[[0, -1]] = refinement.end_cells
    heights = [
        np.linspace(start, end, count + 1)[:-1]
        for start, end, count in zip(marks[:-1], marks[1:], cells, strict=True)
    ]
    in_disk = np.repeat(np.arange(len(cells)) % 2 == 1, cells)
    return np.append(np.concatenate(heights), shape.length), in_disk


def _section(z: float, refinement: Refinement, shape: TrunkShape) -> np.ndarray:
    """Nodes of one section [mm]: the middle, then ring after ring."""
    core, rings = refinement.core_rings, refinement.core_rings + refinement.disk_rings
    outer = shape.radius(z)
    nodes = refinement.ring_nodes()
    known = [0.0, _circumradius(shape.core_share * outer, nodes[core]), _circumradius(outer, nodes[-1])]
    radii = np.interp(np.arange(rings + 1), [0, core, rings], known)
    points = [(0.0, 0.0, z)]
    for ring in range(1, rings + 1):
        angles = 2.0 * np.pi * np.arange(nodes[ring]) / nodes[ring]
        points += [(radii[ring] * np.cos(a), radii[ring] * np.sin(a), z) for a in angles]
    return np.array(points)


def _circumradius(radius: float, node_count: int) -> float:
    """Circumradius of the polygon that has the area of a circle."""
    angle = 2.0 * np.pi / node_count
    return radius * np.sqrt(angle / np.sin(angle))


def _triangles(ring_nodes: list[int]) -> np.ndarray:
    """Triangles of a section's rings, shape (triangle_count, 3)."""
    firsts = np.concatenate([[0], np.cumsum(ring_nodes)])
    triangles = []
    for ring, sector in product(range(1, len(ring_nodes)), range(6)):
        inner, outer = ring_nodes[ring - 1], ring_nodes[ring]
        for step in range(outer // 6):
            a, b = (firsts[ring] + (sector * outer // 6 + step + k) % outer for k in (0, 1))
            c, d = (firsts[ring - 1] + (sector * (inner // 6) + step + k) % inner for k in (0, 1))
            triangles.append((a, b, c))
            if step < inner // 6:
                triangles.append((b, d, c))
    return np.array(triangles)


def _best_prism_tets(pair: np.ndarray, triangles: np.ndarray, number: int) -> np.ndarray:
    """Three tetrahedra in each prism between two sections, by the better of two orders.

    A prism's diagonals go from the lower-ranked node of the first section to the higher-ranked
    one of the second. The order alternates from layer to layer, so that the trunk does not twist
    when it bends.

    Args:
        pair: Nodes of both sections [m], shape (2, layout_count, 3).
        triangles: Nodes of the section's triangles, shape (triangle_count, 3).
        number: Index of the first section.

    Returns:
        Indices into the nodes of both sections, shape (3 · triangle_count, 4).
    """
    points = pair.reshape(-1, 3)
    count = len(pair[0])
    distance = np.round(np.linalg.norm(pair.mean(axis=0)[:, :2], axis=1), 9)
    turn = np.arange(count) * (-1.0) ** number
    best, best_ratio = None, -1.0
    for outwards in (1.0, -1.0):
        rank = np.lexsort((turn, outwards * distance)).argsort()
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
        ratio = radius_ratios(TetMesh(points, tets)).min()
        if ratio > best_ratio:
            best, best_ratio = tets, ratio
    return best


def _faults(mesh: TetMesh) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences."""
    # The first point of a cable is its pull point, on the platform.
    return faults_of(mesh, np.vstack([path[1:] for _, path in cables()]), LOWEST_RADIUS_RATIO)


def _print_cables() -> None:
    """Prints the cables of a scene and the tubes that line the disks, metres, as YAML."""
    print("cables:")
    for name, path in cables():
        is_long = name.startswith("L")
        rows = _rows(path)
        print(f"  - name: {name}")
        print("    pull_point_on: platform")
        print(f"    pull_point: {rows[0]}")
        print("    points:")
        print("\n".join(f"      - {row}" for row in rows[1:]))
        print(f"    shortening: [0.0, {0.070 if is_long else 0.040:.3f}]")
        print("    rate: 0.05")
        print("    tension: [0.0, 30.0]")
    print("tubes:")
    for azimuth in range(4):
        rows = _rows(cable_path(azimuth, DISK_COUNT)[1:])
        for disk in range(DISK_COUNT):
            lower, upper = rows[2 * disk : 2 * disk + 2]
            print(f"  - {{name: tube_{azimuth}_{disk}, axial_stiffness: 250.0,")
            print(f"     points: [{lower}, {upper}]}}")


def _rows(points: np.ndarray) -> list[str]:
    """Points [mm] as YAML, in metres."""
    return [f"[{', '.join(f'{1e-3 * x:.5f}' for x in point)}]" for point in points + 0.0]


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 1 when one of them cannot be used."""
    parser = mesh_parser("Mesh the Trunk.", REFINEMENTS)
    parser.add_argument(
        "--cables", action="store_true", help="print a scene's cables and tubes, make no mesh"
    )
    options = parser.parse_args(arguments)
    if options.cables:
        _print_cables()
        return 0
    made = make_all(options, "trunk", REFINEMENTS, make_trunk, _faults)
    return 0 if made else 1


if __name__ == "__main__":
    sys.exit(main())
