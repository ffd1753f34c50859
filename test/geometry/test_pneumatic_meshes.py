"""Facts of the kept meshes of pneumatic robots: their regions, their cavities, their symmetry."""

from pathlib import Path
from typing import NamedTuple

import meshio
import numpy as np
import pytest

from meshes.mesh_making import PneumaticMesh, mirror, turn_about_z
from softrobot_twin.geometry.closed_surface import closed_surface
from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.tet_mesh import TetMesh

MESHES = Path(__file__).resolve().parents[2] / "meshes"


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
SYMMETRIES = {
    "springy": (turn_about_z(3), mirror(1)), "pneunet_finger": (mirror(2),),
    "segment": (turn_about_z(4), mirror(1)), "fetch": (turn_about_z(3), mirror(1)),
}  # fmt: skip


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


@pytest.fixture(scope="module", params=KEPT)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def robot(name):
    return name.rpartition("_")[0]


@pytest.fixture(scope="module")
def made(name):
    return read(MESHES / f"{name}.msh")


def region_box(made, region):
    """Smallest and largest coordinates of a region [mm]."""
    nodes = made.mesh.node_positions[made.mesh.cells[made.regions[region]].ravel()]
    return 1e3 * np.stack([nodes.min(axis=0), nodes.max(axis=0)])


def test_every_committed_mesh_with_cavities_is_checked_here():
    without = "bar_", "finger_", "stifface_", "segment_hexa_", "fast_pneunet_"
    own = {path.stem for path in MESHES.glob("*.msh") if not path.stem.startswith(without)}
    assert own == set(KEPT)


def test_each_refinement_has_its_size_and_no_flat_element(name, made):
    assert KEPT[name].lowest <= made.mesh.node_count <= KEPT[name].highest
    assert radius_ratios(made.mesh).min() >= KEPT[name].quality


@pytest.mark.sampled
def test_the_package_reads_the_same_body_and_has_nothing_else_to_note(name, made):
    reading = read_solid_mesh(MESHES / f"{name}.msh")
    np.testing.assert_array_equal(reading.mesh.cells, made.mesh.cells)
    np.testing.assert_array_equal(reading.mesh.node_positions, made.mesh.node_positions)
    assert all("triangle" in note for note in reading.notes)


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


@pytest.mark.sampled
def test_the_normals_of_a_cavity_point_into_the_body(made):
    def cycles(triangles):
        return {tuple(np.roll(each, -each.argmin())) for each in triangles}

    surface = cycles(made.mesh.surface_triangles)
    for triangles in made.cavities.values():
        assert cycles(triangles[:, ::-1]) <= surface


def test_the_body_is_one_piece_whose_only_other_surface_is_the_outside(made):
    triangles = made.mesh.surface_triangles
    label = np.arange(made.mesh.node_count)
    while True:  # The lowest node of each piece of the surface spreads over it.
        lowest = label.copy()
        np.minimum.at(lowest, triangles, label[triangles].min(axis=1, keepdims=True))
        if (lowest == label).all():
            break
        label = lowest
    pieces = np.unique(label[triangles[:, 0]])
    inner = {int(label[each[0, 0]]) for each in made.cavities.values()}
    assert len(inner) == len(made.cavities)
    assert len(pieces) == len(inner) + 1
    corners = made.mesh.node_positions[triangles]
    for piece in pieces:
        volume = np.linalg.det(corners[label[triangles[:, 0]] == piece]).sum() / 6
        assert (volume < 0) == (int(piece) in inner)


@pytest.mark.sampled
def test_a_mesh_maps_onto_itself(robot, made):
    positions = made.mesh.node_positions
    index = {tuple(node): k for k, node in enumerate(np.round(1e6 * positions).astype(int))}
    tets = np.unique(np.sort(made.mesh.cells, axis=1), axis=0)
    for matrix in SYMMETRIES[robot]:
        mapped = np.round(1e6 * positions @ matrix.T).astype(int)
        image = np.array([nearby(index, node) for node in mapped])
        np.testing.assert_array_equal(
            np.unique(np.sort(image[made.mesh.cells], axis=1), axis=0), tets
        )


def nearby(index, node):
    """Index of a node whose coordinates differ by at most one from the given whole numbers."""
    steps = np.stack(np.meshgrid(*[[0, -1, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return next(index[key] for key in map(tuple, node + steps) if key in index)


@pytest.mark.parametrize("size", (400, 1532, 4000))
def test_the_springy_is_50_mm_high_and_as_thick_as_a_cylinder_of_its_radius(size):
    made = read(MESHES / f"springy_{size}.msh")
    low, high = region_box(made, "body")
    assert (low[2], high[2]) == pytest.approx((0.0, 50.0), abs=1e-9)
    bottom = made.mesh.surface_triangles
    corners = 1e3 * made.mesh.node_positions[bottom]
    corners = corners[(np.abs(corners[:, :, 2]) < 1e-9).all(axis=1)]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    ).sum()  # fmt: skip
    assert area == pytest.approx(np.pi * 22.5**2, rel=1e-9)


@pytest.mark.parametrize("size", (400, 1500))
def test_a_pneunet_finger_fills_its_box_and_its_layer_lies_below_the_gas(size):
    made = read(MESHES / f"pneunet_finger_{size}.msh")
    boxes = [region_box(made, region) for region in ("body", "layer")]
    np.testing.assert_allclose(boxes[0], [[-115, 2, -10], [0, 30, 10]], atol=1e-9)
    np.testing.assert_allclose(boxes[1], [[-115, 0, -10], [0, 2, 10]], atol=1e-9)
    assert 1e9 * made.mesh.volumes[made.regions["layer"]].sum() == pytest.approx(115 * 20 * 2)
    gas = 1e3 * made.mesh.node_positions[np.unique(made.cavities["cavity"])]
    np.testing.assert_allclose(gas.min(axis=0), [-111, 2, -6], atol=1e-9)
    np.testing.assert_allclose(gas.max(axis=0), [-20, 26.5, 6], atol=1e-9)


@pytest.mark.parametrize("size", (1000, 4000))
def test_the_chambers_of_a_segment_lie_behind_walls_of_their_thickness(size):
    made = read(MESHES / f"segment_{size}.msh")
    box = region_box(made, "body")
    assert (box[0, 2], box[1, 2]) == pytest.approx((0.0, 102.0))
    for number, (x, y) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1)), start=1):
        gas = 1e3 * made.mesh.node_positions[np.unique(made.cavities[f"cavity_{number}"])]
        across = gas[:, :2] * (x, y)
        assert across.min(axis=0) == pytest.approx((1.0, 1.0))  # half a wall from the planes
        assert gas[:, 2].min() == pytest.approx(6.9)
        assert gas[:, 2].max() == pytest.approx(102 - 6.9)
        outer = np.linalg.norm(1e3 * made.mesh.node_positions[:, :2], axis=1).max()
        inner = np.linalg.norm(across, axis=1).max()
        assert inner / outer == pytest.approx(20.2 / 22.2, rel=1e-6)


@pytest.mark.parametrize("size", (1500, 5152))
def test_the_plates_of_the_fetch_close_the_accordions_of_each_module(size):
    made = read(MESHES / f"fetch_{size}.msh")
    heights = {
        "plate_0": (0, 6), "module_1": (6, 55), "plate_1": (55, 61), "module_2": (61, 110),
        "plate_2": (110, 116),
    }  # fmt: skip
    for region, (low, high) in heights.items():
        assert region_box(made, region)[:, 2] == pytest.approx((low, high), abs=1e-9)
    for module in (1, 2):
        for leg, azimuth in zip("abc", np.radians([0, 120, 240]), strict=True):
            cavity = made.cavities[f"cavity_{module}_{leg}"]
            gas = 1e3 * made.mesh.node_positions[np.unique(cavity)]
            assert (gas[:, 2].min(), gas[:, 2].max()) == pytest.approx(heights[f"module_{module}"])
            axis = 22 * np.array([np.cos(azimuth), np.sin(azimuth)])
            assert np.linalg.norm(gas[:, :2].mean(axis=0) - axis) < 1e-6


@pytest.fixture(scope="module")
def finger():
    return read(MESHES / "pneunet_finger_400.msh")
