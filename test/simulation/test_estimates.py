"""Facts of the error that a simulation estimates of itself."""

import copy

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Hold, Simulation


def sagged(model_scene, mesh: str):
    mapping = copy.deepcopy(model_scene.model_dump(mode="json"))
    mapping["body"]["mesh"]["file"] = f"../../meshes/{mesh}.vtk"
    mapping["cables"] = []
    simulation = Simulation(scene_from_mapping(mapping, model_scene.path))
    rest = simulation.effector_positions()
    for _ in range(30):
        if simulation.step(Hold()).report.residual < 1e-8:
            break
    sag = np.linalg.norm(simulation.effector_positions() - rest)
    return sag, simulation.discretization_error()


def test_the_discretization_error_of_a_sagging_diamond_is_of_the_right_size(diamond):
    scene = diamond().scene
    fine, _ = sagged(scene, "diamond_15000")
    for mesh in ("diamond_400", "diamond_1600", "diamond_4500"):
        sag, estimate = sagged(scene, mesh)
        assert 0.25 * (fine - sag) < estimate < 2.0 * (fine - sag)


def test_without_effectors_there_is_no_estimate(diamond):
    simulation = diamond(lambda m: m.pop("effectors"))
    assert np.isnan(simulation.discretization_error())


def test_at_rest_there_is_no_error(diamond):
    assert diamond().discretization_error() == pytest.approx(0.0, abs=1e-12)
