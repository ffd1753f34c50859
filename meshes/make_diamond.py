"""Makes the tetrahedral meshes of the Diamond robot: ``python meshes/make_diamond.py``.

The Diamond is one silicone body: a base block, four struts that rise outwards to the corners,
four that rise inwards to a platform. One strut pair and a quarter of the blocks are meshed with
gmsh and mirrored three times, so the body bends no more to one side than to the other. The base
is a volume of its own in every refinement: the region that a scene fixes does not depend on the
element size.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

# The script also runs from a checkout that is not installed.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from meshes.mesh_making import faults_of, mesh_parser, write_usable  # noqa: E402
from softrobot_twin.geometry.tet_mesh import TetMesh  # noqa: E402

# Name of a refinement (about its number of nodes) and its edge length [m].
EDGE_LENGTHS = {
    150: 60e-3, 200: 30e-3, 400: 20e-3, 600: 16e-3, 1000: 13.5e-3, 1600: 9.32e-3,
    2700: 6.6e-3, 4500: 5.0e-3, 9000: 3.5e-3, 15000: 2.8e-3,
}  # fmt: skip
LOWEST_RADIUS_RATIO = 0.15
# Edges longer than the struts' thickness give worse elements at their ends. Such a mesh only serves
# to show the loss of accuracy.
COARSE_EDGE_LENGTH = 22e-3
COARSE_RADIUS_RATIO = 0.13
# Factor for the edge length at the corners of the blocks, which deform little.
BLOCK_COARSENING = 1.2
# gmsh's algorithms: they put few nodes inside thin struts.
SURFACE_ALGORITHM = 8
VOLUME_ALGORITHM = 1


@dataclass(frozen=True)
class DiamondShape:
    """Dimensions of the Diamond [m]; heights are z, radii are distances from the z axis.

    Attributes:
        bottom: Height of the underside.
        top: Height of the platform's upper side.
        corner_radius: Radius of the four corners' flat ends, where the cables hold.
        corner_height: Height at which the centrelines of two struts meet.
        elbow_radius: Radius at which they meet.
        block_half_width: Half the side of the square base block and platform.
        strut_depth: Thickness of a strut in its vertical plane.
        strut_width: Thickness of a strut across it.
    """

    bottom: float = -37e-3
    top: float = 126e-3
    corner_radius: float = 97e-3
    corner_height: float = 45e-3
    elbow_radius: float = 87e-3
    block_half_width: float = 15e-3
    strut_depth: float = 20e-3
    strut_width: float = 21.75e-3

    def strut_slope(self, height: float) -> float:
        """Angle of a strut that spans the given height, outer side to centreline [rad].

        The strut's outer side starts at the block's edge; its centreline ends at the elbow:
        (elbow_radius − block_half_width) tan a + strut_depth / (2 cos a) = height.
        """
        run = self.elbow_radius - self.block_half_width
        amplitude = math.hypot(run, height)
        # run·sin a − height·cos a = −strut_depth / 2
        return math.atan2(height, run) - math.asin(0.5 * self.strut_depth / amplitude)

    def profile(self) -> np.ndarray:
        """Outline of a strut pair in its vertical plane, (radius, height) [m], shape (7, 2)."""
        lower = self.strut_slope(self.corner_height - self.bottom)
        upper = self.strut_slope(self.top - self.corner_height)
        lower_half = 0.5 * self.strut_depth / math.cos(lower)
        upper_half = 0.5 * self.strut_depth / math.cos(upper)
        beyond = self.corner_radius - self.elbow_radius
        inner = (lower_half + upper_half) / (math.tan(lower) + math.tan(upper))
        block = self.block_half_width
        return np.array(
            [
                (block, self.bottom),
                (self.corner_radius, self.corner_height + beyond * math.tan(lower) - lower_half),
                (self.corner_radius, self.corner_height - beyond * math.tan(upper) + upper_half),
                (block, self.top),
                (block, self.top - 2.0 * upper_half),
                (
                    self.elbow_radius - inner,
                    self.corner_height - inner * math.tan(lower) + lower_half,
                ),
                (block, self.bottom + 2.0 * lower_half),
            ]
        )

    @property
    def attach_points(self) -> np.ndarray:
        """Points where the four cables hold: N, W, S, E [m], shape (4, 3)."""
        r, z = self.corner_radius, self.corner_height
        return np.array([(0, r, z), (-r, 0, z), (0, -r, z), (r, 0, z)])


def make_diamond(edge_length: float, shape: DiamondShape = DiamondShape()) -> TetMesh:
    """Meshes the Diamond.

    Args:
        edge_length: Edge length aimed at in the struts [m].
        shape: Dimensions of the body.

    Returns:
        The mesh [m]; it is always the same for one version of gmsh.

    Raises:
        ModuleNotFoundError: gmsh is not installed.
        OSError: gmsh misses a system library, which the error names.
    """
    return _mirrored(*_quarter(edge_length, shape))


def _quarter(edge_length: float, shape: DiamondShape) -> tuple[np.ndarray, np.ndarray]:
    """Nodes [m] and tetrahedra of the eastern quarter, |y| ≤ x."""
    import gmsh

    gmsh.initialize([], readConfigFiles=False, interruptible=False)
    try:
        for option, value in {
            "General.Terminal": 0,
            "General.NumThreads": 1,
            "Mesh.RandomSeed": 1,
            "Mesh.Algorithm": SURFACE_ALGORITHM,
            "Mesh.Algorithm3D": VOLUME_ALGORITHM,
        }.items():
            gmsh.option.setNumber(option, value)
        _add_quarter_volumes(gmsh.model, shape)
        for point in gmsh.model.getEntities(0):
            x, y, _ = 1e-3 * np.array(gmsh.model.getValue(0, point[1], []))
            # Corners of the blocks, but not those where a strut meets one.
            in_block = x < shape.block_half_width - 1e-6 or abs(y) > 0.5 * shape.strut_width + 1e-6
            coarsening = BLOCK_COARSENING if in_block else 1.0
            gmsh.model.mesh.setSize([point], 1e3 * edge_length * coarsening)
        gmsh.model.mesh.generate(3)
        for method in ("", "Netgen", ""):
            gmsh.model.mesh.optimize(method, niter=3)
        tags, coordinates, _ = gmsh.model.mesh.getNodes()
        _, corner_tags = gmsh.model.mesh.getElementsByType(4)
    finally:
        gmsh.finalize()
    index_of_tag = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    index_of_tag[tags.astype(np.int64)] = np.arange(len(tags))
    tets = index_of_tag[corner_tags.astype(np.int64)].reshape(-1, 4)
    return 1e-3 * coordinates.reshape(-1, 3), tets


def _add_quarter_volumes(model, shape: DiamondShape) -> None:
    """Adds one strut pair and its quarters of both blocks, in millimetres, sharing faces."""
    occ = model.occ

    def prism(corners: np.ndarray, extrusion: tuple[float, float, float]) -> list:
        points = [occ.addPoint(*corner) for corner in corners]
        ahead = points[1:] + points[:1]
        lines = [occ.addLine(start, end) for start, end in zip(points, ahead, strict=True)]
        face = occ.addPlaneSurface([occ.addCurveLoop(lines)])
        return [entity for entity in occ.extrude([(2, face)], *extrusion) if entity[0] == 3]

    profile = 1e3 * shape.profile()
    width, half = 1e3 * shape.strut_width, 1e3 * shape.block_half_width
    strut = prism([(r, -0.5 * width, z) for r, z in profile], (0.0, width, 0.0))
    blocks = []
    for low, high in ((profile[0, 1], profile[6, 1]), (profile[4, 1], profile[3, 1])):
        corners = [(0.0, 0.0, low), (half, -half, low), (half, half, low)]
        blocks += prism(corners, (0.0, 0.0, high - low))
    occ.fragment(strut, blocks)
    occ.synchronize()


def _mirrored(positions: np.ndarray, tets: np.ndarray) -> TetMesh:
    """Mirrors the eastern quarter in the planes y = x and y = −x, and joins the four."""
    positions = np.round(positions, 10)
    swapped = positions[:, [1, 0, 2]]
    half_turn = np.array([-1.0, -1.0, 1.0])
    quarters = [positions, swapped, positions * half_turn, swapped * half_turn]
    every_node = np.concatenate(quarters) + 0.0  # + 0.0 makes −0.0 and 0.0 one
    reflected = tets[:, [0, 1, 3, 2]]
    every_tet = np.concatenate(
        [
            number * len(positions) + (reflected if number % 2 else tets)
            for number in range(len(quarters))
        ]
    )
    # After rounding, the nodes on a mirror plane coincide exactly.
    nodes, indices = np.unique(every_node, axis=0, return_inverse=True)
    return TetMesh(nodes, indices.reshape(-1)[every_tet])


def _faults(mesh: TetMesh, shape: DiamondShape, edge_length: float) -> list[str]:
    """Reasons why a mesh cannot be used, as sentences."""
    asked = COARSE_RADIUS_RATIO if edge_length > COARSE_EDGE_LENGTH else LOWEST_RADIUS_RATIO
    return faults_of(mesh, 1e3 * shape.attach_points, asked)


def _jobs(arguments: list[str] | None) -> list[tuple[Path, float]]:
    """Files asked for, and the edge length [m] of each."""
    parser = mesh_parser("Mesh the Diamond robot.", EDGE_LENGTHS,
                         "folder, or file of a single mesh")
    parser.add_argument("--edge-length", type=float, help="one mesh of this edge length [m]")
    options = parser.parse_args(arguments)
    if options.edge_length is not None:
        if options.size:
            parser.error("give --size or --edge-length, not both")
        if not 1e-3 <= options.edge_length <= 1.0:
            parser.error("--edge-length is in metres, from 0.001 to 1")
        edge_lengths = {f"{1e3 * options.edge_length:g}mm": options.edge_length}
    else:
        edge_lengths = {size: EDGE_LENGTHS[size] for size in options.size or EDGE_LENGTHS}
    if options.output.suffix == ".vtk":
        if len(edge_lengths) > 1:
            parser.error("--output must be a folder when several meshes are made")
        return [(options.output, edge_length) for edge_length in edge_lengths.values()]
    return [(options.output / f"diamond_{name}.vtk", edge_length)
            for name, edge_length in edge_lengths.items()]


def _missing_gmsh() -> str | None:
    """Message with what to install when gmsh cannot be loaded; None when it can."""
    try:
        import gmsh  # noqa: F401
    except ModuleNotFoundError:
        return "gmsh is missing: install it with 'python -m pip install gmsh'."
    except OSError as error:
        return f"gmsh misses a system library, install the one it names: {error}."
    return None


def main(arguments: list[str] | None = None) -> int:
    """Makes the requested meshes; returns 1 when one of them cannot be used."""
    jobs = _jobs(arguments)
    missing = _missing_gmsh()
    if missing:
        print(missing, file=sys.stderr)
        return 1
    shape, written = DiamondShape(), True
    for path, edge_length in jobs:
        mesh = make_diamond(edge_length, shape)
        written &= write_usable(path, mesh, _faults(mesh, shape, edge_length))
    return 0 if written else 1


if __name__ == "__main__":
    sys.exit(main())
