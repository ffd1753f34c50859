"""The tendon robot of two sections, against the model of piecewise constant curvature.

Rao et al. 2021 compare this model with others on the same numbers. Between two disks the wire is an
arc of the angle θ, and a tendon at the distance r from it, inwards, is its chord,
2 (l/θ - r) sin θ/2. Without weight θ minimises the energy of bending and the work of the tensions, for
each arc alone.
"""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from softrobot_twin.scene import load_scene
from softrobot_twin.simulation import CommandEfforts, FollowTargets, Simulation, Status
from test.scene_changes import solved

SCENE = Path(__file__).resolve().parents[2] / "config" / "scenes" / "tdcr.yaml"
BENDING, ARC, RADIUS = 54.0e9 * 0.25 * np.pi * 0.0007**4, 0.020, 0.010


def tip_of_arcs(tendons):
    """Tip (x, z) [m]; for each of both sections the tensions [N] and distances inwards [m]."""
    heading, tip = 0.0, np.zeros(2)
    for section in tendons:
        def energy(angle, section=section):
            arc = ARC * np.sinc(0.5 * angle / np.pi)
            chords = sum(tension * (arc - 2.0 * inwards * np.sin(0.5 * angle))
                         for tension, inwards in section)  # fmt: skip
            return 0.5 * BENDING * angle**2 / ARC + chords

        angle = minimize_scalar(energy, bounds=(-0.4, 0.4), options={"xatol": 1e-12}).x
        for _ in range(10):
            across = heading + 0.5 * angle
            tip += ARC * np.sinc(0.5 * angle / np.pi) * np.array([np.sin(across), -np.cos(across)])
            heading += angle
    return tip


def pulled(tensions, changes):
    robot = Simulation(load_scene(SCENE, changes))
    for step in range(30):
        efforts = min(1.0, (step + 1) / 15) * np.asarray(tensions, float)
        result = solved(robot, CommandEfforts(efforts, 0.1))
    return result.effector_positions[0]


@pytest.mark.parametrize("near, far", [(2.0, 0.0), (8.0, 0.0), (9.0, 4.0), (3.0, 5.0)])
def test_without_weight_it_bends_as_arcs_of_constant_curvature(near, far):
    opposite = (2.0 * far, -0.5 * RADIUS)
    expected = tip_of_arcs([[(near, RADIUS), opposite], [opposite]])
    tip = pulled([near, 0.0, 0.0, 0.0, far, far], {"gravity": (0.0, 0.0, 0.0)})
    np.testing.assert_allclose(tip[[0, 2]], expected, atol=0.1e-3)
    assert abs(tip[1]) < 1e-9


def test_twice_as_many_elements_move_the_tip_hardly():
    tips = [pulled([6.0, 2.0, 0.0, 0.0, 4.0, 0.0], {"beams[0].elements": count})
            for count in (20, 40)]  # fmt: skip
    np.testing.assert_allclose(tips[0], tips[1], atol=0.15e-3)


@pytest.mark.exhaustive
def test_it_follows_its_tip_to_random_reachable_points(drawn_rng):
    random = drawn_rng
    robot = Simulation(load_scene(SCENE))
    start = robot.state
    for _ in range(10):
        tensions = np.where(random.random(6) < 0.5, random.uniform(0.0, 5.0, 6), 0.0)
        point = pulled(tensions, {})
        robot.restore(start)
        for step in range(100):
            share = min(1.0, (step + 1) / 60)
            target = (1.0 - share) * np.array([0.0, 0.0, -0.400]) + share * point
            target += 0.1 * share * (1.0 - share) * np.array([0.0, 0.0, 1.0])  # it cannot lengthen
            result = robot.step(FollowTargets(target[None], 0.1))
        assert result.status is Status.OK, tensions
        np.testing.assert_allclose(result.effector_positions[0], point, atol=0.1e-3)
