"""What each effect of a scene costs and changes: `explain --effects`."""

import numpy as np
import pytest

from softrobot_twin.harness.sampled_axes import ActuationError
from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.effect_costs import NOTHING, effect_costs, path_of
from test.builder import builder
from test.scene_changes import yaml_file

BOX = {"mesh": {"box": {"size": [0.1, 0.02, 0.02], "cells": [5, 1, 1]}}, "name": "beam",
       "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-6, 1, 1]}}]}  # fmt: skip
TIP = {"name": "tip", "points": [[0.1, 0.01, 0.01]]}


@builder
def write(tmp_path, /, **mapping):
    """Writes a scene file, and loads it."""
    file = yaml_file(tmp_path / "scene.yaml", {"name": "scene", **mapping})
    return load_scene(file)


@builder
def beam(write, /, law="neo_hookean", material=(), element="linear", cable=(), **entries):
    """Makes a cantilever with a cable along it."""
    material = {"law": law, "young_modulus": 1e5, "poisson_ratio": 0.45, "density": 1000.0, **dict(material)}
    cable = {"name": "cable", "pull_point": [-0.01, 0.01, 0.02],
             "points": [[0.1, 0.01, 0.02]], "shortening": [0.0, 0.03], "rate": 0.1,
             **dict(cable)}  # fmt: skip
    mapping = {"gravity": [0.0, 0.0, -9.81], "effectors": [TIP], **entries}
    return write(body={**BOX, "element": element, "material": material}, cables=[cable], **mapping)


def costs(scene, given=()):
    return {cost.name: cost for cost in effect_costs(scene, given)}


def test_only_effects_that_the_scene_names_are_left_out(beam):
    assert list(costs(beam(gravity=[0, 0, 0]))) == [NOTHING.name]
    assert list(costs(beam())) == ["gravity", NOTHING.name]


@pytest.mark.exhaustive
def test_many_effects_of_a_scene_are_left_out_one_by_one(beam):
    viscous = {"viscosity": [{"share": 0.3, "time": 0.2}]}
    found = costs(beam(material=viscous, integration="dynamic", element="smoothed",
                       cable={"axial_stiffness": 1e4, "friction": 0.2}))  # fmt: skip
    assert list(found) == [
        "motion in time", "gravity", "viscosity of materials", "stretch of cables",
        "friction along cables", "volume patches", "strain smoothed over edges", NOTHING.name,
    ]  # fmt: skip


def test_equal_scenes_do_not_differ(beam):
    nothing = costs(beam())[NOTHING.name]
    assert nothing.on_the_way == nothing.at_the_end == nothing.force == 0.0
    assert np.isfinite(nothing.cost) and abs(nothing.share) < 1.0


def test_without_gravity_the_tip_is_where_its_weight_does_not_bend_it(beam):
    """wL⁴/8EI; linear elements of this mesh bend less."""
    scene = beam(law="corotational")
    sag = 1000.0 * 9.81 * 0.02**2 * 0.1**4 / (8.0 * 1e5 * 0.02**4 / 12.0)
    found = costs(scene, ["cable_shortening_m=0.0"])["gravity"]
    assert 0.1 * sag < found.at_the_end < sag
    assert found.on_the_way >= found.at_the_end and found.force > 0.0


def test_motion_in_time_matters_on_the_way_and_not_at_rest(beam):
    found = costs(beam(integration="dynamic"))["motion in time"]
    assert found.on_the_way > 1e-4
    assert found.at_the_end < 0.5 * found.on_the_way


def test_an_effect_that_cannot_be_left_out_says_why(write):
    ball = {"name": "ball", "mass": 0.01, "sphere": {"radius": 0.01}}
    found = costs(write(
        integration="dynamic", rigid_bodies=[ball], gravity=[0, 0, -9.81],
        effectors=[{"name": "ball", "body": "ball", "points": [[0, 0, 0]]}],
    ))  # fmt: skip
    assert "cannot be left out" in found["motion in time"].reason and "ball" in found["motion in time"].reason
    assert found["gravity"].at_the_end > 0.1


def test_actuators_move_within_their_rates_and_then_hold(beam):
    path = path_of(Simulation(beam(cable={"rate": 0.005})), ())
    steps = np.abs(np.diff(path, axis=0))
    assert steps.max() <= 0.005 * 0.02 + 1e-12 and (steps[-49:] == 0.0).all()
    assert path[0, 0] > path[-1, 0] and np.abs(path[-1] - path[0]).max() == pytest.approx(0.01, rel=0.02)


def test_an_actuator_without_limits_needs_an_actuation(beam):
    with pytest.raises(ActuationError, match="--at"):
        costs(beam(cable={"shortening": [float("-inf"), float("inf")]}))
