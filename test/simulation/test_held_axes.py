"""Nodes that are held along some axes: floors without friction and planes of symmetry, to round-off."""

from dataclasses import replace

import numpy as np
import pytest

from softrobot_twin.analysis.apparent_compliance import apparent_compliance
from softrobot_twin.analysis.mesh_error import MeshErrorEstimator
from softrobot_twin.errors import SceneError
from softrobot_twin.geometry.tet_mesh import TetMesh
from softrobot_twin.reduction.reduction_states import refuse_unreducible
from softrobot_twin.simulation import FollowTargets, Hold, Status
from test.builder import builder, each_of
from test.finite_differences import central_slopes
from test.scene_changes import repeat_step

SIZE, YOUNG, RATIO = np.array([0.03, 0.02, 0.04]), 1e5, 0.3
element = each_of(["linear", "quadratic", "smoothed", "hexahedral"])


def near(axis, place, axes=None):
    """Nodes of a face across an axis, held along it or along others."""
    low, high = np.full((2, 3), [[-1.0], [1.0]])
    low[axis], high[axis] = place - 1e-6, place + 1e-6
    return {"box": {"minimum": low.tolist(), "maximum": high.tolist()}, "axes": axes or ["xyz"[axis]]}


PLANES = [near(axis, 0.0) for axis in range(3)]


@builder
def box(simulate, /, fixed, element="linear", gravity=(0.0, 0.0, 0.0), body=None, **entries):
    """Makes a block of a corotational law, its least corner at the origin."""
    material = {"young_modulus": YOUNG, "poisson_ratio": RATIO, "density": 1000.0}
    own = {"mesh": {"box": {"size": SIZE.tolist(), "cells": [3, 2, 4]}}, "element": element, "fixed": fixed,
           "material": material, "volume": "per_element", **(body or {})}  # fmt: skip
    return simulate(bodies=[own], gravity=gravity, **entries)


def test_a_block_between_plates_without_friction_is_strained_uniformly(box, element):
    block, strain = box([*PLANES, near(2, SIZE[2])], element), 0.05
    rest = block.model.nodes.rest_positions
    pressed = np.where(rest[:, 2:] > 0.99 * SIZE[2], rest * [1.0, 1.0, 1.0 - strain], rest)
    block.restore(replace(block.state, positions=pressed))
    assert repeat_step(block, Hold(), 8).status is Status.OK
    expected = rest * (1.0 + strain * np.array([RATIO, RATIO, -1.0]))
    np.testing.assert_allclose(block.state.positions, expected, rtol=0, atol=1e-14 * SIZE[2] + 1e-17)
    np.testing.assert_array_equal(block.state.positions[pressed[:, 2] != rest[:, 2]][:, 2], SIZE[2] * (1 - strain))


@pytest.mark.parametrize("mass", ["lumped", "consistent"])
def test_a_floor_without_friction_bears_the_weight_and_nothing_else(box, element, mass):
    block = box([near(2, 0.0), {"nodes": [0], "axes": ["x", "y"]}, {"nodes": [45], "axes": ["y"]}], element,
                (0.0, 0.0, -9.81), {"mass": mass}, reactions=[{"name": "base", "of": "body"}])
    force = repeat_step(block, Hold(), 12).state.memory["reactions.wrenches"][0, :3]
    assert np.ptp(block.state.positions[:, 0]) > 1.001 * SIZE[0]
    np.testing.assert_allclose(force, [0.0, 0.0, 9.81 * 1000.0 * SIZE.prod()], rtol=1e-9, atol=1e-9)


@pytest.fixture(params=["linear", "quadratic"])
def halves(request, simulate, body_of, block):
    """Half a bar on its plane of symmetry, across x, and the whole bar; both with cables above and below.

    Not of smoothed elements: these share strains across the plane.
    """
    half = block(size=(0.01, 0.02, 0.08), cells=(1, 2, 5), shake=0.0)
    points, middle = half.node_positions, half.node_positions[:, 0] < 1e-9
    number = np.where(middle, np.arange(len(points)), len(points) - 1 + np.cumsum(~middle))
    cells = np.vstack([half.cells, number[half.cells][:, [1, 0, 2, 3]]])
    whole = TetMesh(np.vstack([points, points[~middle] * [-1, 1, 1]]), cells)

    def bar(name, mesh, fixed, sides):
        cables = [
            {"name": f"{name}{len(sides) - side}", "pull_point": [0.005 * side, y, 0.0], "shortening": [0.0, 0.03],
             "points": [[0.005 * side, y, 0.04], [0.005 * side, y, 0.08]], "tension": [0.0, 50.0]}
            for name, y in (("low", 0.002), ("high", 0.018)) for side in sides]  # fmt: skip
        body = body_of(mesh, name, element=request.param, fixed=[near(2, 0.0, ["x", "y", "z"]), *fixed])
        tip = {"name": "tip", "points": [[0.0, 0.01, 0.08]], "directions": ["y"]}
        return simulate(body=body, cables=cables, gravity=[0.0, -2.0, -9.81], effectors=[tip])

    return bar("half", half, PLANES[:1], [1]), bar("whole", whole, [], [1, -1])


def test_half_a_bar_moves_as_the_whole_one(halves):
    half, whole = (
        repeat_step(bar, FollowTargets(bar.effector_positions() + [[0.0, 0.01, 0.0]], 1.0), 25) for bar in halves)
    assert half.status is Status.OK and half.effector_positions[0, 1] > 0.015
    rest, other = (bar.model.nodes.rest_positions for bar in halves)
    same = np.linalg.norm(rest[:, None] - other, axis=2).argmin(axis=1)
    np.testing.assert_allclose(half.state.positions, whole.state.positions[same], atol=1e-8)
    assert np.abs(half.state.positions[rest[:, 0] == 0.0, 0]).max() < 1e-25
    np.testing.assert_allclose(half.efforts, whole.efforts[::2], rtol=1e-4, atol=1e-6)
    yields, both = (apparent_compliance(bar).compliance[0] for bar in halves)
    np.testing.assert_allclose(yields, 2.0 * both * np.outer([0, 1, 1], [0, 1, 1]), rtol=1e-5, atol=1e-9)


def test_half_a_bar_has_the_mesh_error_of_the_whole_one(halves):
    for half, whole in zip(*(MeshErrorEstimator(bar.scene).responses() for bar in halves), strict=True):
        np.testing.assert_allclose(half.gravity, whole.gravity, rtol=1e-4)
        np.testing.assert_allclose(half.W_ea, whole.W_ea[:, ::2] + whole.W_ea[:, 1::2], rtol=1e-4)


@pytest.mark.parametrize("scheme", ["backward_euler", "generalized_alpha"])
def test_momentum_along_free_axes_is_conserved(box, element, scheme, drawn_rng):
    block = box([near(2, 0.0)], element, integration="dynamic", time_scheme=scheme)
    free, inertia = block.model.nodes.free_axes, next(term for term in block.model.forces if term.is_inertia)
    block.restore(replace(block.state, velocities=0.05 * drawn_rng.standard_normal(free.shape) * free))
    before = inertia.momentum(block.state.velocities)
    assert repeat_step(block, Hold(0.002), 15).status is Status.OK
    np.testing.assert_allclose(inertia.momentum(block.state.velocities)[:2], before[:2], rtol=1e-9)
    assert np.abs(block.state.velocities * (1.0 - free)).max() < 1e-25


def test_masses_accelerate_as_if_held_axes_were_left_out(box, drawn_rng):
    block = box([near(2, 0.0), near(0, 0.0)], "quadratic", integration="dynamic")
    term = next(term for term in block.model.forces if term.is_inertia)
    M, free = block.model.bodies[0].mass_matrix(True).toarray(), block.model.nodes.free_axes
    forces, found = drawn_rng.standard_normal(free.shape) * free, np.zeros_like(free)
    term.add_accelerations(block.state.positions, forces, found)
    np.testing.assert_allclose(np.where(free, M @ found, found), forces, atol=1e-12)


def test_the_tangent_is_the_slope_of_the_forces_along_free_axes(box, drawn_rng):
    block = box([*PLANES, {"nodes": [30], "axes": ["x", "z"]}], solver={"factorization": "superlu"})
    model, balance = block.model, block.newton.balance
    free = model.nodes.free_axes.astype(bool)
    x, own = model.nodes.rest_positions.copy(), model.nodes.free_nodes
    x[own] += 1e-3 * drawn_rng.standard_normal(free.shape) * free
    balance.assemble(x, np.zeros(0), False)
    found = model.factorization.matrix().toarray()[np.ix_(free.ravel(), free.ravel())]
    slopes = central_slopes(lambda at: balance.gather_forces(at).copy(), x, own, 1e-7)
    np.testing.assert_allclose(found, -slopes[free][:, free.ravel()], atol=1e-6 * np.abs(found).max())
    assert not slopes[~free].any() and model.factorization.factor() == (np.linalg.eigvalsh(found)[0] > 0.0)
    assert np.abs(model.factorization.solve(np.ones(free.shape))[~free]).max() < 1e-27


PLATE = {"name": "plate", "motion": "guided", "box": {"size": [0.1, 0.1, 0.01]}}
ACROSS = {"name": "across", "pull_point": [-0.01, 0.01, 0.02], "points": [[0.0, 0.01, 0.02]], "tension": [0.0, 9.0]}


@pytest.mark.parametrize("body, entries, reason", [
    ({"fixed": [near(2, 0.0)]}, {}, "floats away"),
    ({"vertebrae": {"rigid": [{"name": name, "region": name} for name in "ab"]}}, {}, "bodies with vertebrae"),
    ({"reduced": {"file": "a.npz"}}, {}, "reduced bodies"),
    ({"attached": [{"to": "plate", "nodes": [1]}]}, {"rigid_bodies": [PLATE]}, "a node is held or attached"),
    ({}, {"cables": [ACROSS]}, "it moves nothing"),
    ({}, {"forces": [{"name": "press", "points": [[0.01, 0.01, 0.0]], "direction": [0, 0, 1]}]}, "it moves nothing"),
    ({}, {"sensors": [{"name": "gap", "string": [[0.01, 0.01, 0.0]], "pull_point": [0.01, 0.01, -0.01],
                       "weight": 1.0}]}, "no target moves it"),
])  # fmt: skip
def test_what_is_not_built_is_refused(box, body, entries, reason):
    with pytest.raises(SceneError, match=reason):
        box([PLANES[0], *PLANES], body=body, **entries)


def test_held_axes_are_no_unknowns(box):
    free, held = (box([*PLANES, *more]) for more in ([], [near(0, SIZE[0])]))
    assert free.dof_count == 3 * 60 - 15 - 20 - 12 and held.dof_count == free.dof_count - 15


def test_a_body_held_along_some_axes_gets_no_basis(box):
    block = box(PLANES)
    with pytest.raises(SceneError, match="fixed.axes"):
        refuse_unreducible(block.scene, block.model.bodies[0])


def test_axes_turn_with_a_body_in_a_pattern(box):
    fixed = [{"nodes": [0, 1, 15]}, {**near(2, SIZE[2]), "frame": "mesh", "axes": ["x"]}]
    robot = box(fixed, body={"repeat": {"count": 2, "about": [0, 0, 1], "angle": np.pi / 2}})
    assert [one.entry.fixed[1].axes for one in robot.model.bodies] == [("x",), ("y",)]
