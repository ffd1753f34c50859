"""Repair of surfaces from files: edges that do not match, triangles with wrong orientation."""

import meshio
import numpy as np
import pytest

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry.closed_surface import closed_surface
from softrobot_twin.geometry.mass_properties import surface_mass_properties
from softrobot_twin.geometry.shapes import Box, Capsule
from softrobot_twin.geometry.surface_reading import read_solid_surface

SIZE = np.array([0.04, 0.03, 0.02])


def written(path, points, triangles):
    meshio.write(path, meshio.Mesh(points, [("triangle", np.asarray(triangles))]), binary=True)
    return path


def volume(solid):
    closed_surface(solid.triangles, len(solid.points))
    return surface_mass_properties(solid.points, solid.triangles).volume


@pytest.fixture
def box():
    return Box([0.1, 0.2, 0.3], SIZE).surface(np.inf)


def test_a_valid_surface_is_read_unchanged(tmp_path, box):
    solid = read_solid_surface(written(tmp_path / "rock.stl", *box), notes=(notes := []))
    assert notes == []
    assert volume(solid) == pytest.approx(SIZE.prod(), rel=1e-6)


def test_a_flipped_surface_is_reversed_and_the_report_names_its_file(tmp_path, box):
    notes = []
    path = written(tmp_path / "rock.stl", box[0], box[1][:, ::-1])
    solid = read_solid_surface(path, notes=notes)
    assert volume(solid) == pytest.approx(SIZE.prod(), rel=1e-6)
    assert len(notes) == 1
    assert notes[0].startswith("rock.stl: reversed")


@pytest.mark.parametrize("seed", range(5))
def test_triangles_with_the_wrong_orientation_are_reversed(tmp_path, seed):
    points, triangles = Capsule([[0, 0, 0], [0, 0, 0.05]], 0.02).surface(0.01)
    random = np.random.default_rng(seed)
    some = random.choice(len(triangles), len(triangles) // 4, replace=False)
    before = surface_mass_properties(points, triangles).volume
    triangles = triangles.copy()
    triangles[some] = triangles[some, ::-1]
    notes = []
    solid = read_solid_surface(written(tmp_path / "rock.stl", points, triangles), notes=notes)
    assert volume(solid) == pytest.approx(before, rel=1e-5)
    assert f"rock.stl: reversed {len(some)} triangles" in notes[0]


@pytest.mark.parametrize("scale", [1e-3, 1.0, 10.0])
def test_a_t_junction_is_cut_open_and_closed(tmp_path, scale):
    """One side has its edge cut in the middle twice, its neighbour has it whole."""
    points, triangles = Box([0, 0, 0], [0.04, 0.03, 0.02]).surface(np.inf)
    t = triangles[0]
    middles = [points[t[0]] + f * (points[t[1]] - points[t[0]]) for f in (0.37, 0.71)]
    n = len(points)
    points = np.vstack([points, middles]) * scale
    triangles = np.vstack([triangles[1:], [[t[0], n, t[2]], [n, n + 1, t[2]], [n + 1, t[1], t[2]]]])
    with pytest.raises(MeshError):
        closed_surface(triangles, len(points))
    notes = []
    solid = read_solid_surface(written(tmp_path / "rock.stl", points, triangles), notes=notes)
    assert volume(solid) == pytest.approx(SIZE.prod() * scale**3, rel=1e-6)
    assert "T-junction" in notes[0]


def test_triangles_without_area_are_dropped(tmp_path, box):
    points, triangles = box
    t = triangles[0]
    n = len(points)
    points = np.vstack([points, 0.5 * (points[t[0]] + points[t[1]])])
    # The seam is closed by a triangle of no area between both halves and the whole edge.
    triangles = np.vstack([triangles[1:], [[t[0], n, t[2]], [n, t[1], t[2]], [t[0], t[1], n]]])
    notes = []
    solid = read_solid_surface(written(tmp_path / "rock.stl", points, triangles), notes=notes)
    assert volume(solid) == pytest.approx(SIZE.prod(), rel=1e-6)
    assert any("without area" in note for note in notes)


def test_a_hollow_solid_keeps_its_cavity(tmp_path, box):
    points, triangles = box
    inner = 0.5 * (points - points.mean(axis=0)) + points.mean(axis=0)
    both = np.vstack([triangles, triangles[:, ::-1] + len(points)])
    notes = []
    path = written(tmp_path / "rock.stl", np.vstack([points, inner]), both)
    solid = read_solid_surface(path, notes=notes)
    assert notes == []
    assert volume(solid) == pytest.approx(SIZE.prod() * 7 / 8, rel=1e-6)


def test_a_surface_that_is_open_or_encloses_nothing_is_refused_by_file_name(tmp_path, box):
    leaf = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), [[0, 1, 2], [2, 1, 0]]
    for part, told in (((box[0], box[1][1:]), ": surface edge .* belongs to 1 triangles"),
                       (leaf, "")):  # fmt: skip
        with pytest.raises(MeshError, match=rf"rock\.stl{told}"):
            read_solid_surface(written(tmp_path / "rock.stl", *part), notes=[])


def test_distances_of_a_surface_are_those_of_its_shape_and_zero_inside(tmp_path, box):
    solid = read_solid_surface(written(tmp_path / "box.stl", *box), notes=[])
    points = np.random.default_rng(2).uniform([0.06, 0.16, 0.27], [0.14, 0.24, 0.33], (200, 3))
    exact = Box([0.1, 0.2, 0.3], SIZE).distances(points)
    assert 5 < np.count_nonzero(exact == 0.0) < 100
    np.testing.assert_allclose(solid.distances(points), exact, atol=1e-7)
