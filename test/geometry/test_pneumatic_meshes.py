"""Facts of the kept meshes of pneumatic robots: their regions, their cavities, their symmetry."""

from typing import NamedTuple

import meshio
import numpy as np
import pytest

from meshes.mesh_making import PneumaticMesh
from softrobot_twin.geometry.closed_surface import closed_surface
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.tet_mesh import TetMesh
from test.builder import each_of
from test.places import MESHES


class Kept(NamedTuple):
    """What a kept mesh must be like.

    Attributes:
        lowest: Lowest number of nodes.
        highest: Highest number of nodes.
        quality: Lowest radius ratio.
    """

    lowest: int
    highest: int
    quality: float


# Three fingers of a PneuNet gripper have 1214 nodes, the Springy 1532, the Fetch 5152: within 2 %.
KEPT = {
    "springy_400": Kept(380, 420, 0.1), "springy_964": Kept(964, 964, 0.2),
    "springy_1444": Kept(1444, 1444, 0.3), "springy_1532": Kept(1502, 1562, 0.2),
    "springy_4000": Kept(3800, 4200, 0.25),
    "pneunet_finger_400": Kept(397, 412, 0.15), "pneunet_finger_620": Kept(620, 620, 0.11),
    "pneunet_finger_1000": Kept(1000, 1050, 0.11), "pneunet_finger_1500": Kept(1400, 1600, 0.15),
    "segment_1000": Kept(950, 1050, 0.2), "segment_1500": Kept(1480, 1530, 0.2),
    "segment_2300": Kept(2250, 2310, 0.2), "segment_4000": Kept(3900, 4100, 0.25),
    "fetch_1500": Kept(1450, 1600, 0.1), "fetch_3714": Kept(3714, 3714, 0.3),
    "fetch_5152": Kept(5049, 5255, 0.2), "fetch_5586": Kept(5586, 5586, 0.24),
}  # fmt: skip
REGIONS = {
    "springy": {"body"}, "pneunet_finger": {"body", "layer"}, "segment": {"body"},
    "fetch": {"plate_0", "plate_1", "plate_2", "module_1", "module_2"},
}  # fmt: skip
# Volume of each cavity [cm³], and by how much a polygon may change it.
CAVITIES = {
    "springy": ({"cavity": 5.47}, 1e-6),
    "pneunet_finger": ({"cavity": 8.9}, 1e-6),
    "segment": ({f"cavity_{number}": 24.794 for number in range(1, 5)}, 0.01),
    "fetch": ({f"cavity_{module}_{leg}": 8.0 for module in (1, 2) for leg in "abc"}, 1e-6),
}


def read(path):
    """A mesh file with its physical groups."""
    content = meshio.read(path)
    tags = content.cell_data_dict["gmsh:physical"]
    cells = content.cells_dict
    names = {2: {}, 3: {}}
    for name, (tag, dimension) in content.field_data.items():
        names[dimension][name] = tag
    return PneumaticMesh(
        TetMesh(content.points, cells["tetra"]),
        {name: np.flatnonzero(tags["tetra"] == tag) for name, tag in names[3].items()},
        {name: cells["triangle"][tags["triangle"] == tag].astype(np.int64)
         for name, tag in names[2].items()},
    )  # fmt: skip


name = each_of(KEPT, scope="module")


@pytest.fixture(scope="module")
def robot(name):
    return name.rpartition("_")[0]


@pytest.fixture(scope="module")
def made(name):
    return read(MESHES / f"{name}.msh")


def test_every_committed_mesh_with_cavities_is_checked_here():
    without = "bar_", "finger_", "stifface_", "segment_hexa_", "fast_pneunet_"
    own = {path.stem for path in MESHES.glob("*.msh") if not path.stem.startswith(without)}
    assert own == set(KEPT)


def test_each_refinement_has_its_size_and_no_flat_element(name, made):
    assert KEPT[name].lowest <= made.mesh.node_count <= KEPT[name].highest
    assert radius_ratios(made.mesh).min() >= KEPT[name].quality


def test_each_tetrahedron_belongs_to_one_region(robot, made):
    assert set(made.regions) == REGIONS[robot]
    every = np.concatenate(list(made.regions.values()))
    np.testing.assert_array_equal(np.sort(every), np.arange(made.mesh.cell_count))


def test_each_cavity_is_closed_and_has_its_volume(robot, made):
    volumes, tolerance = CAVITIES[robot]
    assert set(made.cavities) == set(volumes)
    for cavity, volume in volumes.items():
        triangles = made.cavities[cavity]
        closed_surface(triangles, made.mesh.node_count)  # raises when it is open or flipped
        a, b, c = np.moveaxis(made.mesh.node_positions[triangles], 1, 0)
        flux = np.einsum("ti,ti->", np.cross(a, b), c) / 6
        assert 1e6 * flux == pytest.approx(volume, rel=tolerance)
