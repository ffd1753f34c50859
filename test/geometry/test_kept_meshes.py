"""Facts of every mesh that is kept, whatever robot it is of."""

import numpy as np
import pytest

from softrobot_twin.geometry.quality import radius_ratios
from softrobot_twin.geometry.surface import boundary_triangles
from test.builder import each_of
from test.places import MESHES

# Lowest and highest number of nodes, and lowest radius ratio.
KEPT = {
    "diamond_150": (130, 170, 0.13), "diamond_200": (180, 220, 0.13),
    "diamond_400": (350, 450, 0.15), "diamond_600": (550, 650, 0.15),
    "diamond_1000": (900, 1100, 0.15), "diamond_1600": (1500, 1800, 0.15),
    "diamond_2700": (2500, 2900, 0.15), "diamond_4500": (4000, 5000, 0.15),
    "diamond_9000": (8500, 9500, 0.15), "diamond_15000": (14000, 16000, 0.15),
    "flexo_hand_48": (48, 48, 0.3), "flexo_hand_216": (216, 216, 0.3),
    "grasper_finger_158": (150, 170, 0.35), "grasper_finger_180": (180, 180, 0.35),
    "grasper_finger_360": (360, 360, 0.24), "grasper_finger_400": (350, 450, 0.35),
    "grasper_finger_1200": (1100, 1300, 0.35),
    "octoleg_120": (115, 125, 0.2), "octoleg_173": (173, 173, 0.12), "octoleg_400": (350, 450, 0.2),
    "octoleg_1000": (900, 1100, 0.2),
    "trunk_700": (680, 740, 0.6), "trunk_900": (880, 920, 0.38), "trunk_1600": (1600, 1700, 0.6), "trunk_4000": (3000, 4500, 0.45),
}  # fmt: skip


name = each_of(KEPT, scope="module")


@pytest.fixture
def mesh(name, kept_mesh):
    return kept_mesh(name)


def test_every_committed_mesh_is_checked_here():
    assert {path.stem for path in MESHES.glob("*.vtk")} == set(KEPT)


def test_each_refinement_has_its_size(mesh, name):
    lowest, highest, _ = KEPT[name]
    assert lowest <= mesh.node_count <= highest


def test_no_element_is_badly_shaped(mesh, name):
    assert radius_ratios(mesh).min() >= KEPT[name][2]


def test_the_surface_is_closed(mesh):
    corners = mesh.node_positions[boundary_triangles(mesh.cells)]
    flux = np.einsum("ti,ti->", np.cross(corners[:, 0], corners[:, 1]), corners[:, 2]) / 6
    assert flux == pytest.approx(mesh.volume, rel=1e-12)
