"""Facts of building a scene: what is warned, what is refused, what is not built."""

import subprocess
import sys

import numpy as np
import pytest

from softrobot_twin.mechanics.laws import law_named
from softrobot_twin.simulation import Hold
from test.places import ROOT


def test_a_cable_point_just_outside_is_snapped_to_the_surface_with_a_warning(diamond):
    simulation = diamond(lambda m: m["cables"][1].update(points=[[-0.099, 0.0, 0.045]]))
    (note,) = [note for note in simulation.notes if "snapped" in note]
    assert "cables[1].points[0]" in note and "2.000 mm" in note
    point = simulation.actuator_paths()["west"][1]
    np.testing.assert_allclose(point, [-0.097, 0.0, 0.045], atol=1e-9)
    assert np.all(simulation.model.actuators.terms[0].paths[1].points.barycentric_weights >= 0.0)


def test_points_in_the_wrong_order_are_warned_of(diamond):
    points = [[0.0, 0.02, 0.0], [0.0, 0.097, 0.045], [0.0, 0.05, 0.01]]
    simulation = diamond(
        lambda m: m["cables"][0].update(points=[[0.0, 0.097, 0.045], [0.0, 0.085, 0.045]])
    )
    assert any("folds back" in note and "north" in note for note in simulation.notes), points


def test_a_well_made_scene_has_no_warnings(diamond):
    assert diamond().notes == ()


@pytest.mark.parametrize("change, word", [
    (lambda m: m["body"]["material"].update(density=1.07), "density"),
    (lambda m: m["body"]["material"].update(density=1.07e6), "density"),
    (lambda m: m["body"]["material"].update(young_modulus=180.0), "young_modulus"),
    (lambda m: m["body"]["material"].update(young_modulus=2e3), "sag"),
    (lambda m: m.update(gravity=[0, 0, -9810.0]), "sag"),
])  # fmt: skip
def test_wrong_units_are_warned_of(diamond, change, word):
    assert any(word in note for note in diamond(change).notes)


def test_millimetres_read_as_metres_are_warned_of(diamond):
    def millimetres(mapping):
        mapping["body"]["mesh"]["scale"] = 1000.0
        mapping["body"]["fixed"] = [{"box": {"minimum": [-15, -15, -40], "maximum": [15, 15, 10]}}]
        for key in ("cables", "effectors", "markers"):
            mapping.pop(key)

    assert any("then give scale: 0.001" in note for note in diamond(millimetres).notes)


def test_a_body_of_a_few_micrometres_may_be_scaled_without_need(simulate):
    tiny = {"mesh": {"box": {"size": [2e-4, 1e-4, 1e-4], "cells": [2, 1, 1]}}, "element": "linear",
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
            "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [0, 1, 1]}}]}
    assert any("then leave out scale: 0.001" in note for note in simulate(body=tiny).notes)


def test_a_scene_builds_only_the_terms_it_names(diamond):
    def weightless(mapping):
        mapping["gravity"] = [0, 0, 0]
        for key in ("cables", "effectors", "markers"):
            mapping.pop(key)

    full, bare = diamond(), diamond(weightless)
    assert [t.name for t in full.terms] == [
        "corotational elements", "gravity", "cables", "effectors",
    ]  # fmt: skip
    assert [t.name for t in bare.terms] == ["corotational elements"]
    assert "optimise" in full.stages and "optimise" not in bare.stages
    assert bare.step(Hold()).report.residual == pytest.approx(0.0, abs=1e-9)


@pytest.mark.sampled
@pytest.mark.parametrize("element, node_count", [("linear", 4), ("quadratic", 10)])
@pytest.mark.parametrize("law", ["corotational", "linear"])
def test_only_the_named_law_and_element_are_built(diamond, element, node_count, law):
    model = diamond({"body.element": element, "body.material.law": law}).model
    (elastic,) = (term for term in model.forces if term.name != "gravity")
    assert elastic.name == f"{law} elements"
    assert type(elastic.law) is law_named(law).parameters
    assert elastic.stencils().shape[1] == node_count
    mesh = model.bodies[0].mesh
    assert (mesh.node_count > mesh.corner_mesh.node_count) == (element == "quadratic")


@pytest.mark.exhaustive
def test_building_and_stepping_load_no_viewer_no_ros_and_no_mesher():
    scene = ROOT / "config" / "scenes" / "diamond.yaml"
    code = (
        "import sys; from softrobot_twin.simulation import Simulation, Hold; "
        f"Simulation.from_scene_file({str(scene)!r}).step(Hold()); print(*sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    modules = set(done.stdout.split())
    assert "softrobot_twin.simulation" in modules
    assert not {"rerun", "rclpy", "matplotlib", "gmsh", "softrobot_twin.view"} & modules
