"""A body that is a box without a file, wherever commands read, refine or write meshes."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import yaml

from softrobot_twin.geometry.cad_meshing import CadMesh, write_msh
from softrobot_twin.mechanics.reduced_elements import SampledPoints
from softrobot_twin.reduction.body_training import output_path
from softrobot_twin.reduction.training_options import TrainingOptions
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import Simulation
from softrobot_twin.simulation.building.reduced_body import (
    BodyReduction,
    reduction_fingerprints,
    write_body_reduction,
)
from softrobot_twin.simulation.building.vertebrae import reduction_path
from softrobot_twin.simulation.command import Hold
from softrobot_twin.study.accuracy_study import (
    Setting,
    hexahedral_family,
    mesh_family,
    only_body,
    with_element,
    write_scene_copy,
)
from softrobot_twin.study.reduced_models import every_level, reduced_models
from test.scene_changes import repeat_step, yaml_file

SCENE = {
    "name": "bar",
    "body": {
        "mesh": {"box": {"size": [0.1, 0.02, 0.02], "cells": [4, 2, 2]}},
        "element": "linear",
        "material": {"young_modulus": 5.0e5, "poisson_ratio": 0.4, "density": 1000.0},
        "fixed": {"box": {"minimum": [-1.0, -1.0, -1.0], "maximum": [0.001, 1.0, 1.0]}},
    },
    "effectors": {"name": "tip", "points": [0.1, 0.01, 0.01]},
}


@pytest.fixture(autouse=True)
def one_refinement(monkeypatch):
    monkeypatch.setattr("softrobot_twin.study.accuracy_study.REFINEMENTS", 1)


@pytest.fixture
def path(tmp_path):
    return yaml_file(tmp_path / "bar.yaml", SCENE)


def sagged(scene) -> np.ndarray:
    simulation = Simulation(scene)
    repeat_step(simulation, Hold(0.02), 3)
    return simulation.state.positions


def test_a_box_sags_as_the_same_mesh_from_a_file(path):
    box = load_scene(path)
    mesh = Simulation(box).model.bodies[0].mesh
    write_msh(path.with_name("bar.msh"), CadMesh(mesh, {}, {}, (), ""))
    path.write_text(yaml.safe_dump({**SCENE, "body": {**SCENE["body"], "mesh": "bar.msh"}}))
    np.testing.assert_array_equal(sagged(box), sagged(load_scene(path)))


def test_a_box_sags_straight_down(path):
    """Its mesh is its own image in the mirror y: weight moves no node of that plane aside."""
    moved = sagged(load_scene(path)) - Simulation(load_scene(path)).state.positions
    middle = np.isclose(Simulation(load_scene(path)).state.positions[:, 1], 0.01)
    assert moved[:, 2].min() < -1e-3
    assert np.abs(moved[middle, 1]).max() < 1e-6 * np.abs(moved[:, 2]).max()


def test_a_box_is_made_of_what_the_element_asks_for(path):
    scene = load_scene(path)
    counts = {"linear": (96, 0), "quadratic": (96, 0), "hexahedral": (0, 16)}
    for element, (tets, hexahedra) in counts.items():
        simulation = Simulation(with_element(scene, element))
        assert (simulation.tet_count, simulation.hexahedron_count) == (tets, hexahedra)


def test_its_meshes_are_refined_and_made_of_hexahedra_for_a_study(path):
    scene = load_scene(path)
    levels = mesh_family(scene, path.parent / "meshes")
    assert [level.name for level in levels] == ["box", "box_refined_1"]
    assert [level.tet_count for level in levels] == [96, 768]
    (of_hexahedra,) = hexahedral_family(scene)
    assert of_hexahedra.name == "box_hexa" and of_hexahedra.tet_count == 16


@pytest.mark.parametrize("element", ["linear", "quadratic", "hexahedral"])
def test_a_study_has_each_mesh_once_with_each_element_whatever_the_scene_has(path, element):
    scene = with_element(load_scene(path), element)
    levels = mesh_family(scene, path.parent / "meshes")
    every = every_level(levels, hexahedral_family(scene))
    assert [(level.name, level.scene.body.element) for level in every] == [
        ("box", "linear"), ("box_refined_1", "linear"), ("box", "quadratic"),
        ("box_refined_1", "quadratic"), ("box_hexa", "hexahedral"),
    ]  # fmt: skip


@pytest.mark.parametrize("element", ["linear", "quadratic", "hexahedral"])
def test_a_reduced_model_is_found_by_its_mesh_and_element(path, element):
    levels = every_level(mesh_family(load_scene(path), path.parent), hexahedral_family(load_scene(path)))
    body = only_body(with_element(load_scene(path), element))
    cells = np.linspace(0, body.mesh.cell_count - 1, 5).astype(np.int64)
    points = SampledPoints(cells, np.zeros(5, np.int64), np.ones(5))
    # Stretch and shear along the box, and bends: nothing is moved at its fixed end.
    along = body.mesh.node_positions[:, 0] / body.mesh.node_positions[:, 0].max()
    basis = np.concatenate([power[:, None, None] * np.eye(3) for power in (along, along**2)], 2)
    basis[body.fixed] = 0.0
    reduction = BodyReduction(basis, 6, points, points, np.ones(6), np.full(2, np.nan), {})
    file = path.with_name("bar_reduced.npz")
    write_body_reduction(file, reduction, reduction_fingerprints(body))
    (model,) = reduced_models((file,), (), levels)
    assert (model.level.scene.body.element, model.point_count) == (element, 5)


def test_a_copy_of_its_scene_keeps_the_box_or_names_the_refined_mesh(path):
    levels = mesh_family(load_scene(path), path.parent / "meshes")
    for level in levels:
        copy = path.with_name(f"{level.name}.yaml")
        setting = Setting(level.name, "linear", "corotational", 2, None)
        write_scene_copy(copy, level.scene, setting, ["a remark"])
        assert Simulation(load_scene(copy)).tet_count == level.tet_count
    assert load_scene(path.with_name("box.yaml")).body.mesh.box is not None
    assert load_scene(path.with_name("box_refined_1.yaml")).body.mesh.box is None


def test_files_that_are_made_from_it_lie_beside_its_scene(path):
    scene = load_scene(path)
    body = Simulation(scene).model.bodies[0]
    assert output_path(scene, body, TrainingOptions()) == path.parent / "bar_reduced.npz"
    mapping = {**SCENE, "body": {**SCENE["body"], "vertebrae": {"rigid": [
        {"name": name, "box": {"minimum": [low, -1.0, -1.0], "maximum": [low + 0.02, 1.0, 1.0]}}
        for name, low in (("root", -0.001), ("tip", 0.081))]}}}  # fmt: skip
    path.write_text(yaml.safe_dump(mapping))
    scene = load_scene(path)
    made = reduction_path(SimpleNamespace(entry=scene.body), scene)
    assert made == path.parent / "body_vertebrae.npz"
