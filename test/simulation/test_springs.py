"""Springs of a scene: to ground, between bodies, along a path; and bodies coupled by them."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold
from test.scene_changes import solved

G = 9.81
HELD = [{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}]


def settle(scene, time_step=0.1, count=80):
    result = solved(scene, Hold(time_step), count)
    assert result.report.residual < 1e-8
    return result.state.positions


def tension(scene, index=0):
    """Pull of one spring of the scene's term [N]."""
    (term,) = [term.on_points for term in scene.model.forces if term.name == "springs"]
    lengths = term.lengths(scene.state.positions)
    return float((term.stiffness * (lengths - term.rest_lengths))[index])


def test_a_rigid_body_hangs_on_springs_to_ground_by_its_weight(simulate):
    corners = [[x, y] for x in (-0.02, 0.02) for y in (-0.01, 0.01)]
    scene = simulate(
        rigid_bodies=[{"name": "box", "box": {"size": [0.04, 0.02, 0.01]}, "mass": 0.1}],
        springs=[{
            "name": f"s{k}", "stiffness": 100.0, "damping": 2.0,
            "ends": [{"on": "box", "point": [x, y, 0.005]}, {"point": [x, y, 0.105]}],
        } for k, (x, y) in enumerate(corners)],
        integration="dynamic",
    )  # fmt: skip
    positions = settle(scene)
    np.testing.assert_allclose(positions[0], [0, 0, -0.1 * G / 400.0], atol=1e-8)
    for index in range(4):
        assert tension(scene, index) == pytest.approx(0.1 * G / 4.0, rel=1e-6)


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_spring_to_ground_carries_the_load_that_a_soft_body_does_not(
    simulate, body_of, block, integration
):
    """Held at its foot, it is pulled up by a stiff spring until its weight hangs on that."""
    mesh = block(size=(0.03, 0.03, 0.06), cells=(1, 1, 2), shake=0)
    scene = simulate(
        body=body_of(mesh, young_modulus=2e4, fixed=HELD, damping={"mass": 5.0}),
        springs=[{
            "name": "up", "stiffness": 1e3, "rest_length": 0.04,
            "ends": [{"on": "soft", "point": [0.015, 0.015, 0.06]},
                     {"point": [0.015, 0.015, 0.11]}],
        }],
        integration=integration,
    )  # fmt: skip
    positions = settle(scene)
    top = scene.model.nodes.rest_positions[:, 2] > 0.0599
    assert np.all(positions[top, 2] > 0.06)
    # The residual of elasticity and weight at the free nodes is the force of the spring.
    forces = np.zeros((scene.model.nodes.free_node_count, 3))
    scene.model.forces[0].add_forces(positions, forces)
    next(term for term in scene.model.forces if term.name == "gravity").add_forces(
        positions, forces
    )
    assert tension(scene) > 2.0 * 0.03 * 0.03 * 0.06 * 1000.0 * G
    assert np.linalg.norm(forces.sum(axis=0)) == pytest.approx(tension(scene), rel=1e-6)


def test_a_soft_body_carries_the_whole_weight_of_a_rigid_one_on_springs(simulate, body_of, block):
    """The rigid body hangs on one spring below a soft cantilever: the spring carries m g."""
    mesh = block(size=(0.1, 0.03, 0.03), cells=(4, 1, 1), shake=0)
    held = [{"box": {"minimum": [-1e-6, -1, -1], "maximum": [1e-6, 1, 1]}}]
    at = [0.1, 0.015, 0.0]
    found = []
    for time_step in (0.02, 0.3):
        scene = simulate(
            body=body_of(mesh, fixed=held, damping={"mass": 5.0}),
            rigid_bodies=[{"name": "load", "sphere": {"radius": 0.01}, "mass": 0.05,
                           "position": [0.1, 0.015, -0.06]}],
            springs=[{"name": "rope", "stiffness": 300.0, "damping": 1.0, "ends": [
                {"on": "soft", "point": at}, {"on": "load", "point": [0.1, 0.015, -0.05]}]}],
            integration="dynamic",
        )  # fmt: skip
        positions = settle(scene, time_step, 400)
        assert tension(scene) == pytest.approx(0.05 * G, rel=1e-5)
        found.append(positions)
    # It hangs straight below its support.
    corner = np.flatnonzero(np.linalg.norm(mesh.node_positions - [0.1, 0, 0], axis=1) < 1e-9)[0]
    assert found[0][corner, 2] < -0.005
    # Nothing holds it from turning about the rope: its centre is looked at, and the soft body.
    count = mesh.node_count + 1
    np.testing.assert_allclose(found[1][:count], found[0][:count], atol=2e-6)


def test_a_tube_along_a_beam_stiffens_it_by_its_axial_stiffness(simulate, body_of, block):
    """Pulled along its axis, beam and tube share the load: EA of both add up."""
    length, width, young = 0.1, 0.02, 5e4
    mesh = block(size=(width, width, length), cells=(2, 2, 5), shake=0)
    stretched = []
    for stiffness in (None, 30.0):
        tube = {} if stiffness is None else {"tubes": [{
            "name": "tube", "axial_stiffness": stiffness,
            "points": [[0.01, 0.01, 0.02 * k] for k in range(6)]}]}  # fmt: skip
        body = body_of(mesh, young_modulus=young, poisson_ratio=0.0, fixed=HELD)
        scene = simulate(body=body, gravity=[0, 0, 0.02], **tube)
        positions = settle(scene, count=10)
        moved = positions[:, 2] - mesh.node_positions[:, 2]
        stretched.append(moved[mesh.node_positions[:, 2] > 0.0999].mean())
    ratio = stretched[0] / stretched[1]
    assert ratio == pytest.approx(1.0 + 30.0 / (young * width**2), rel=0.1)


def test_a_tube_bends_with_the_beam_it_runs_through(simulate, body_of, block):
    """Off the middle, and much stiffer than the beam, it makes a pulled beam bend to its side."""
    mesh = block(size=(0.02, 0.02, 0.1), cells=(2, 2, 5), shake=0)
    body = body_of(mesh, young_modulus=5e4, fixed=HELD)
    tube = {"name": "tube", "axial_stiffness": 300.0,
            "points": [[0.001, 0.01, z] for z in (0.0, 0.033, 0.07, 0.1)]}  # fmt: skip
    scene = simulate(body=body, tubes=[tube], gravity=[0, 0, 30.0])
    positions = settle(scene)
    assert positions[mesh.node_positions[:, 2] > 0.0999, 0].mean() < 0.01 - 0.002


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_spring_a_million_times_stiffer_than_its_body_acts_like_a_fixed_point(
    simulate, body_of, block, integration
):
    """Row 7: where a stiff spring holds a soft body, or none but the node is fixed."""
    mesh = block(size=(0.03, 0.03, 0.06), cells=(1, 1, 2), shake=0)
    x = mesh.node_positions
    corner = int(np.flatnonzero(np.all(x > [0.0299, 0.0299, 0.0599], axis=1))[0])
    fixed = body_of(mesh, young_modulus=2e4, fixed=[*HELD, {"nodes": [corner]}],
                    damping={"mass": 5.0})  # fmt: skip
    alone = settle(simulate(body=fixed, integration=integration))
    sprung = body_of(mesh, young_modulus=2e4, fixed=HELD, damping={"mass": 5.0})
    # A body of 2e4 Pa and 3 cm has some 1e3 N/m or less.
    springs = [{
        "name": f"stiff{axis}", "stiffness": 1e9,
        "ends": [{"on": "soft", "point": list(x[corner])},
                 {"point": list(x[corner] + 0.1 * np.eye(3)[axis])}],
    } for axis in range(3)]  # fmt: skip
    scene = simulate(
        body=sprung, springs=springs, integration=integration,
        solver={"newton_iterations": 30, "residual_tolerance": 1e-7},
    )  # fmt: skip
    result = solved(scene, Hold(0.1), 80)
    assert np.abs(alone - x).max() > 1e-4
    np.testing.assert_allclose(result.state.positions, alone, atol=1e-8)
