"""Blocks between bonded faces, pressed to half of their height: no pattern of the mesh stores less energy."""

from dataclasses import replace

import numpy as np
import pytest

import softrobot_twin

SIDE, HEIGHT = 0.02, 0.01


def pressed_block(cells, element, share, poisson_ratio, **entries):
    """A robot in balance whose block has a share of its height, and the command that holds it there."""
    top = {"minimum": [-1, -1, HEIGHT - 1e-5], "maximum": [1, 1, 1]}
    robot = softrobot_twin.build(
        name="block", gravity=[0, 0, 0],
        body={"mesh": {"box": {"size": [SIDE, SIDE, HEIGHT], "cells": cells}}, "element": element,
              "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-5]}}],
              "attached": [{"to": "top", "box": top}],
              "material": {"law": "neo_hookean", "young_modulus": 2.75e5, "density": 1000.0,
                           "poisson_ratio": poisson_ratio}, **entries},
        rigid_bodies=[{"name": "top", "motion": "guided", "position": [SIDE / 2, SIDE / 2, HEIGHT],
                       "box": {"size": [SIDE, SIDE, 1e-3], "centre": [0, 0, 1e-3]}}],
        effectors=[{"name": "middle", "points": [[SIDE / 2, SIDE / 2, HEIGHT / 2]]}],
        solver={"newton_iterations": 40},
    )  # fmt: skip
    for height in HEIGHT * np.linspace(1.0, share, 6)[1:]:
        pose = {"poses": {"top": [SIDE / 2, SIDE / 2, height]}, "time_step": 0.1}
        robot.step(**pose)
    return robot, pose


@pytest.mark.sampled
@pytest.mark.parametrize("element, cells, poisson_ratio, entries", [
    ("smoothed", [3, 3, 2], 0.475, {}),
    ("linear", [3, 3, 2], 0.475, {"volume": "patches"}),
    ("hexahedral", [3, 3, 3], 0.475, {}),
    ("smoothed", [4, 4, 3], 0.3, {}),
    ("smoothed", [2, 2, 5], 0.475, {}),
    ("smoothed", [3, 3, 4], 0.4999, {}),
    ("smoothed", [4, 4, 3], 0.45, {"volume": "per_element"}),
    ("linear", [2, 2, 5], 0.475, {"volume": "patches"}),
    ("linear", [3, 3, 4], 0.4999, {"volume": "patches"}),
    ("hexahedral", [4, 4, 4], 0.4999, {}),
    ("hexahedral", [2, 2, 5], 0.475, {}),
    ("hexahedral", [1, 1, 5], 0.475, {}),
    ("hexahedral", [2, 6, 3], 0.475, {}),
])  # fmt: skip
def test_a_pressed_block_comes_back_after_its_nodes_are_moved_at_random(
    element, cells, poisson_ratio, entries, drawn_rng
):
    robot, pose = pressed_block(cells, element, 0.5, poisson_ratio, **entries)
    result, simulation = robot.step(**pose), robot.simulation
    assert result.report.residual < 1e-3 and not result.report.projected_tangent
    state, (body,) = simulation.state, simulation.model.bodies
    kicked = state.positions.copy()
    own = body.first_node + np.flatnonzero(~body.fixed)
    size = 0.5 * HEIGHT / max(cells)
    kicked[own] += 0.1 * size * drawn_rng.uniform(-1.0, 1.0, (len(own), 3))
    simulation.restore(replace(state, positions=kicked))
    for _ in range(3):
        robot.step(**pose)
    np.testing.assert_allclose(simulation.state.positions, state.positions, atol=1e-3 * size)
