"""A body's mesh: a file, a CAD file, or a box; each key is refused where it has no effect."""

from __future__ import annotations

import copy
from pathlib import Path

import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.scene import scene_from_mapping

BOX = {"box": {"size": [0.1, 0.02, 0.02], "cell_size": 0.01}}
SCENE = {
    "name": "bar",
    "body": {
        "mesh": BOX,
        "material": {"young_modulus": 1.0e6, "poisson_ratio": 0.4, "density": 1000.0},
        "fixed": {"box": {"minimum": [-1.0, -1.0, -1.0], "maximum": [0.001, 1.0, 1.0]}},
    },
}


def with_mesh(mesh, **body):
    mapping = copy.deepcopy(SCENE)
    mapping["body"] |= {"mesh": mesh, **body}
    return scene_from_mapping(mapping, Path("bar.yaml"))


def test_a_box_needs_no_file():
    mesh = with_mesh(BOX).body.mesh
    assert mesh.file is None and mesh.box.cell_counts == (10, 2, 2)
    assert mesh.label == "the box" and not mesh.is_cad


@pytest.mark.parametrize("mesh, key, word", [
    ({}, "body.mesh.file", "a box in its place"),
    ({**BOX, "file": "bar.msh"}, "body.mesh.file", "beside box"),
    ({**BOX, "scale": 0.001}, "body.mesh.scale", "beside box"),
    ({**BOX, "size": 0.01}, "body.mesh.size", "beside box"),
    ({**BOX, "merge_distance": 0.001}, "body.mesh.merge_distance", "beside box"),
    ({"box": {"size": [0.1, 0.02, 0.02]}}, "body.mesh.box", "exactly one of"),
    ({"box": {**BOX["box"], "cells": [1, 1, 1]}}, "body.mesh.box", "exactly one of"),
    ({"box": {"size": [0.1, 0.0, 0.02], "cell_size": 0.01}}, "body.mesh.box.size[1]", ""),
    ({"box": {"size": [0.1, 0.02, 0.02], "cells": [1, 0, 1]}}, "body.mesh.box.cells[1]", ""),
    ({"box": {"size": [0.1, 0.02, 0.02], "cell_size": 1e-5}}, "body.mesh.box.cell_size",
     "more than 1000000"),
    ({"file": "bar.msh", "size": 0.01}, "body.mesh.size", "has its own"),
    ({"file": "bar.stl"}, "body.mesh.size", "is required"),
    ({"file": "bar.STEP", "size": 0.01, "scale": 0.001}, "body.mesh.scale", "states its unit"),
])  # fmt: skip
def test_a_key_without_effect_or_a_missing_one_is_refused_by_name(mesh, key, word):
    with pytest.raises(SceneError) as error:
        with_mesh(mesh)
    assert error.value.key == key
    assert word in error.value.reason and "\n" not in str(error.value)


def test_a_cad_file_is_named_with_the_size_of_its_tetrahedra():
    mesh = with_mesh({"file": "bar.stl", "size": 0.006, "scale": 0.001}).body.mesh
    assert mesh.is_cad and mesh.label == "bar.stl"


def test_the_folder_of_a_box_is_that_of_its_scene(tmp_path):
    scene = scene_from_mapping(SCENE, tmp_path / "bar.yaml")
    assert scene.mesh_folder(scene.body) == tmp_path.resolve()
    assert scene.mesh_name == "box"
    with pytest.raises(ValueError, match="no mesh file"):
        _ = scene.mesh_path
