"""What is guided further in a step than it is thick pushes what is in its way, and nothing else."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from softrobot_twin.simulation import Hold, Simulation, Status
from test.builder import builder

STEP, ABOVE = 0.01, 0.05
SOFT = {"element": "linear", "material": {"young_modulus": 1e5, "poisson_ratio": 0.4, "density": 1e3}}
FOOT = [{"box": {"minimum": [-1, -1, -1], "maximum": [1e-6, 1, 1]}}]
FAST = {"motion": "guided", "speed": 1e3, "turn_rate": 1e4}
SHAPES = {
    "plate": {"box": {"size": [0.05, 0.05, 0.002]}},
    "sheet": {"box": {"size": [0.05, 0.05, 0.0002]}},
    "rod": {"capsule": {"ends": [[0, -0.03, 0], [0, 0.03, 0]], "radius": 0.001}},
}


@builder
def pressed(scene_of, /, shape, height=0.01, cells=(10, 1, 1), place=(0.08, 0.0, ABOVE), **entries) -> Simulation:
    """A soft bar of 100 mm along x that is held at one end, and something guided above it."""
    size = [0.1, 0.01, height]
    return scene_of(
        gravity=[0, 0, 0],
        body={"name": "bar", "fixed": FOOT, **SOFT,
              "mesh": {"box": {"size": size, "cells": list(cells)}, "translation": [0, -0.005, -height / 2]}},
        rigid_bodies=[{"name": "guide", "position": list(place), **FAST, **shape}],
        **{"contact": {"between": [{"pair": ["bar", "guide"]}]}, **entries},
    )  # fmt: skip


def lead(simulation, way, reach, last):
    """Go down to a height by steps of a length; the states of all steps."""
    heights = np.append(np.arange(ABOVE - reach, last, -reach), last)
    results = []
    for z in heights:
        simulation.model.guides.aim("guide", [*way, z])
        results.append(simulation.step(Hold(STEP)))
    return results


def bar_of(simulation):
    """Where the nodes of the bar are [m]."""
    return simulation.state.positions[: len(simulation.model.bodies[0].mesh.node_positions)]


@pytest.mark.sampled
@pytest.mark.parametrize("reach", [0.004, 0.015, 0.07])
@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
@pytest.mark.parametrize("shape", list(SHAPES))
def test_a_bar_is_never_above_what_is_guided_down_through_it(pressed, shape, integration, reach):
    simulation = pressed(SHAPES[shape], integration=integration)
    lead(simulation, (0.08, 0.0), reach, -0.015)
    x = bar_of(simulation)
    rest = simulation.model.nodes.rest_positions[: len(x)]
    assert x[rest[:, 0] > 0.095, 2].max() < -0.01


@pytest.mark.parametrize("shape", ["plate", "sheet"])
def test_where_a_bar_comes_to_does_not_depend_on_the_length_of_the_moves(pressed, shape):
    tips = []
    for reach in (0.002, 0.02):
        simulation = pressed(SHAPES[shape], solver={"newton_iterations": 20})
        result = lead(simulation, (0.08, 0.0), reach, -0.01)[-1]
        assert result.status is Status.OK
        tips.append(bar_of(simulation)[:, 2].min())
    assert tips[0] < -0.02
    assert tips[1] == pytest.approx(tips[0], abs=2e-4)


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_thin_soft_wall_is_pushed_by_a_sheet_too(pressed, integration):
    simulation = pressed(SHAPES["sheet"], height=0.001, cells=(20, 2, 1), integration=integration)
    lead(simulation, (0.08, 0.0), 0.03, -0.01)
    x = bar_of(simulation)
    assert x[x[:, 0] > 0.07, 2].max() < -0.01


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_what_is_guided_past_a_bar_does_not_move_it(pressed, integration):
    rest = bar_of(simulation := pressed(SHAPES["rod"], place=(0.13, 0.0, ABOVE), integration=integration)).copy()
    result = lead(simulation, (0.13, 0.0), 0.1, -ABOVE)[-1]
    np.testing.assert_allclose(bar_of(simulation), rest, atol=1e-6)
    assert result.status.is_success


@pytest.mark.parametrize("steps", [1, 4])
def test_a_blade_that_turns_pushes_the_bar_ahead(pressed, steps):
    pivot, turn = np.array([0.12, 0.0, 0.025]), np.radians(25.0)
    simulation = pressed({"box": {"size": [0.14, 0.04, 0.003]}}, place=pivot, cells=(20, 2, 2))
    for k in range(1, steps + 1):
        quaternion = Rotation.from_euler("y", -turn * k / steps).as_quat()
        simulation.model.guides.aim("guide", pivot, quaternion)
        simulation.step(Hold(STEP))
    local = (bar_of(simulation) - pivot) @ Rotation.from_euler("y", -turn).as_matrix()
    beside = np.abs(local[:, 0]) < 0.069
    assert beside.any()
    assert local[beside, 2].max() < -0.0014


@pytest.mark.parametrize("reach", [0.004, 0.06])
def test_a_free_ball_goes_ahead_of_a_plate(scene_of, reach):
    simulation = scene_of(
        gravity=[0, 0, 0], integration="dynamic",
        rigid_bodies=[{"name": "ball", "sphere": {"radius": 0.003}, "mass": 0.01},
                      {"name": "guide", "position": [0, 0, ABOVE], **FAST, **SHAPES["plate"]}],
        contact={"between": [{"pair": ["ball", "guide"]}]},
    )  # fmt: skip
    lead(simulation, (0.0, 0.0), reach, -0.02)
    ball = simulation.state.positions[simulation.model.rigid[0].first_node]
    assert ball[2] == pytest.approx(-0.024, abs=1e-6) or ball[2] < -0.024




def test_a_move_that_nothing_can_follow_is_refused_and_named(pressed):
    floor = [{"name": "floor", "box": {"size": [0.3, 0.3, 0.02]}, "position": [0, 0, -0.0151]}]
    simulation = pressed(
        SHAPES["plate"], obstacles=floor, integration="dynamic",
        contact={"between": [{"pair": ["bar", "guide"]}, {"pair": ["bar", "floor"]}]},
    )  # fmt: skip
    before = bar_of(simulation).copy()
    result = lead(simulation, (0.08, 0.0), 0.1, -0.05)[-1]
    assert result.status is Status.REFUSED
    assert "contact.passing" in result.report.active_limits
    np.testing.assert_allclose(bar_of(simulation), before, atol=1e-12)


def test_a_ball_that_a_post_deflects_from_afar_is_not_called_ok(scene_of):
    simulation = scene_of(
        gravity=[0, 0, 0], integration="dynamic",
        rigid_bodies=[{"name": "ball", "sphere": {"radius": 0.005}, "mass": 0.002,
                       "position": [-0.08, 0.03, 0], "velocity": [5, 0, 0]}],
        obstacles=[{"name": "post", "sphere": {"radius": 0.005}}],
        contact={"between": [{"pair": ["ball", "post"]}]},
    )  # fmt: skip
    first = simulation.model.rigid[0].first_node
    for _ in range(4):
        before = simulation.state.positions[first, 1]
        result = simulation.step(Hold(STEP))
        is_deflected = simulation.state.positions[first, 1] - before > 1e-3
        if result.report.contact_count:
            assert is_deflected and result.status is Status.LINEARIZED
