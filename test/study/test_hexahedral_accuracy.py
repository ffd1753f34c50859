"""Hexahedra beside the tetrahedra of a study of accuracy."""

import meshio
import numpy as np
import pytest

from softrobot_twin.geometry.box_mesh import read_box
from softrobot_twin.harness.study_rows import write_rows
from softrobot_twin.scene import load_scene
from softrobot_twin.study.accuracy import draw_accuracy
from softrobot_twin.study.accuracy_study import (
    Limits,
    hexahedral_family,
    mesh_family,
    study_meshes,
)
from softrobot_twin.study.choice import Measured, choose
from test.scene_changes import yaml_file

pytestmark = pytest.mark.exhaustive

SIZE = (0.02, 0.02, 0.1)
TETS = {10: (1, 1, 5), 20: (2, 2, 6)}
HEXAHEDRA = {5: (1, 1, 5), 40: (2, 2, 6)}


@pytest.fixture(scope="module")
def bar(tmp_path_factory):
    """Scene file of a bar with meshes of both kinds, one of another body among them."""
    folder = tmp_path_factory.mktemp("bar")

    def write(name, mesh, kind, cells):
        meshio.write(folder / name, meshio.Mesh(mesh.node_positions, [(kind, cells)]))

    for number, counts in TETS.items():
        mesh = read_box(SIZE, counts, of_hexahedra=True).mesh
        write(f"bar_{number}.vtk", mesh, "tetra", mesh.as_tets)
    for number, counts in HEXAHEDRA.items():
        mesh = read_box(SIZE, counts, of_hexahedra=True).mesh
        write(f"bar_hexa_{number}.vtk", mesh, "hexahedron", mesh.hexahedra)
    other = read_box((0.02, 0.03, 0.1), (1, 1, 5), of_hexahedra=True).mesh
    write("bar_hexa_99.vtk", other, "hexahedron", other.hexahedra)
    cables = [{"name": name, "pull_point": [x, 0.01, -0.02],
               "points": [[x, 0.01, 0.05], [x, 0.01, 0.09]], "shortening": [0.0, 0.02],
               "rate": 0.05, "tension": [0.0, 20.0]} for name, x in (("a", 0.017), ("b", 0.003))]
    scene = {
        "name": "bar",
        "body": {"mesh": {"file": "bar_10.vtk"}, "element": "linear",
                 "material": {"young_modulus": 2.0e5, "poisson_ratio": 0.45, "density": 1070.0},
                 "fixed": [{"box": {"minimum": [-1, -1, -1e-4], "maximum": [1, 1, 1e-4]}}]},
        "cables": cables, "effectors": [{"name": "tip", "points": [[0.01, 0.01, 0.1]]}],
    }  # fmt: skip
    return yaml_file(folder / "bar.yaml", scene)


@pytest.fixture(scope="module")
def study(bar, tmp_path_factory):
    scene = load_scene(bar)
    levels = mesh_family(scene, tmp_path_factory.mktemp("none"))
    limits = Limits(1_500, 1_500, 5)
    hexahedra = hexahedral_family(scene)
    return study_meshes(levels, limits, hexahedra)


def test_hexahedra_of_the_same_body_are_found_by_their_names(bar, tmp_path, capsys):
    scene = load_scene(bar)
    levels, skipped = hexahedral_family(scene), capsys.readouterr().err.splitlines()
    assert [level.name for level in levels] == ["bar_hexa_5", "bar_hexa_40"]
    assert [level.node_count for level in levels] == [24, 63]
    assert len(skipped) == 1 and "bar_hexa_99.vtk is left out, not the body" in skipped[0]
    assert [level.name for level in mesh_family(scene, tmp_path)] == ["bar_10", "bar_20"]


def test_hexahedra_are_far_more_accurate_than_linear_tetrahedra_of_the_same_corners(study):
    def errors(element):
        return np.array([row.error_tensions for row in study.rows
                         if (row.element, row.law) == (element, "corotational")])

    assert np.all(errors("hexahedral") < 0.3 * errors("linear"))


def test_the_picture_and_the_choice_know_hexahedra(bar, study, tmp_path):
    draw_accuracy(tmp_path / "accuracy.png", "bar", study.rows, "a machine")
    assert (tmp_path / "accuracy.png").stat().st_size > 10_000
    write_rows(tmp_path / "accuracy.csv", study.rows)

    def measure(scene, rate, iterations):
        is_hexahedral = scene.body.element == "hexahedral"
        return Measured(1e-3, 1e-3 if is_hexahedral else 1.0, 0.0)

    chosen = tmp_path / "chosen.yaml"
    assert choose(bar, 100.0, tmp_path / "accuracy.csv", chosen, measure) == 0
    scene = load_scene(chosen)
    assert scene.body.element == "hexahedral" and "bar_hexa" in scene.body.mesh.file.name
