"""Makes the meshes of a slim bar, of tetrahedra and of hexahedra: ``python meshes/make_bar.py``.

The bar stands on z = 0 and is 20 × 20 × 100 mm. It shows what hexahedra are worth: both families
have the same boxes, whole (``bar_hexa_99``) or cut into six tetrahedra each (``bar_99``); numbers are
those of their corners. `python -m softrobot_twin accuracy` draws both.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

# The script also runs from a checkout that is not installed.
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from softrobot_twin.geometry.box_mesh import read_box  # noqa: E402
from softrobot_twin.geometry.hexahedral_mesh import HexahedralMesh  # noqa: E402

SIZE = (0.02, 0.02, 0.1)
"""Edges of the bar [m]."""
HEXAHEDRA = {24: (1, 1, 5), 44: (1, 1, 10), 99: (2, 2, 10), 256: (3, 3, 15), 525: (4, 4, 20)}
"""Boxes along each edge, by the number of corners."""
TETRAHEDRA = {99: (2, 2, 10), 256: (3, 3, 15), 525: (4, 4, 20)}


def main(arguments: list[str] | None = None) -> int:
    """Writes all meshes; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path(__file__).resolve().parent,
                        help="folder of the meshes (default: beside the script)")
    options = parser.parse_args(arguments)
    for corners, counts in HEXAHEDRA.items():
        block = read_box(SIZE, counts, of_hexahedra=True).mesh
        write(options.output / f"bar_hexa_{corners}.msh", block, whole=True)
    for corners, counts in TETRAHEDRA.items():
        block = read_box(SIZE, counts, of_hexahedra=True).mesh
        write(options.output / f"bar_{corners}.msh", block, whole=False)
    return 0


def write(path: Path, mesh: HexahedralMesh, whole: bool) -> None:
    """Writes the hexahedra of a mesh, or the tetrahedra that fill them, in Gmsh's format 2.2."""
    import meshio
    import numpy as np

    kind, cells = ("hexahedron", mesh.hexahedra) if whole else ("tetra", mesh.as_tets)
    path.parent.mkdir(parents=True, exist_ok=True)
    tags = [np.ones(len(cells), dtype=np.int32)]
    content = meshio.Mesh(
        mesh.node_positions, [(kind, cells.astype(np.int32))],
        cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
        field_data={"body": np.array([1, 3])},
    )  # fmt: skip
    content.write(path, file_format="gmsh22", binary=True)
    print(f"{path.name}: {mesh.node_count} nodes, {len(cells)} {kind}")


if __name__ == "__main__":
    sys.exit(main())
