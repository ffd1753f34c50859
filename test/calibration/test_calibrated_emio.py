"""Calibration of a mounted robot: what is planted in another Emio is found within its intervals."""

from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.calibration.calibration import calibrate
from softrobot_twin.record.rest_poses import RestPose
from softrobot_twin.scene import load_scene
from softrobot_twin.scene.scene_parameters import changed_scene
from softrobot_twin.simulation import CommandSetpoints, Simulation

SCENE = Path(__file__).resolve().parents[2] / "config" / "scenes" / "emio.yaml"
NOISE = 1.0e-4
KEYS = ["beams.*.material.young_modulus", "hinge_motors.*.offset"]
# Each servo's way inwards, and the radius at which each strip is clamped to the hub.
WAYS = [f"mounting[0].bodies[{leg}].translation[{leg % 2}]" for leg in range(4)]
CLAMPS = [f"beams[{leg}].points[0][{leg % 2}]" for leg in range(4)]


def planted(rng, scene):
    """Another robot: softer or stiffer, zeros off by a degree, places by half a millimetre."""
    values = {f"hinge_motors[{leg}].offset": rng.normal(0.0, 0.02) for leg in range(4)}
    way, clamp = 0.11494 + 1e-3 * rng.normal(), 0.010 + 5e-4 * rng.normal()
    modulus = scene.beams[0].material.young_modulus * np.exp(rng.normal(0.0, 0.1))
    for leg, sign in enumerate((1.0, 1.0, -1.0, -1.0)):
        values |= {WAYS[leg]: -sign * way, CLAMPS[leg]: sign * clamp,
                   f"beams[{leg}].material.young_modulus": modulus}  # fmt: skip
    return values


def poses_of(scene, rng, count):
    """Poses at rest, as cameras see them."""
    simulation, poses = Simulation(scene, with_warnings=False), []
    for _ in range(count):
        aim = rng.uniform(-0.8, 0.8, 4)
        simulation.reset()
        for share in (0.25, 0.5, 0.75, 1.0, 1.0, 1.0):
            setpoints = simulation.rest_setpoints + share * aim
            simulation.step(CommandSetpoints(setpoints, 1.0))
        markers = simulation.marker_positions()
        poses.append(RestPose(
            setpoints, markers + rng.normal(0.0, NOISE, markers.shape), np.full((1, 3), np.nan),
            np.full(4, np.nan), np.empty((0, 3)),
        ))  # fmt: skip
    return poses


def off_and_widths(estimate, true):
    """Distances from the middle of the intervals, by half their widths; and these."""
    low, high = estimate.intervals.T
    print("distance from the middle, by half the width:", np.round(off := (2.0 * true - low - high) / (high - low), 2))
    return off, 0.5 * (high - low)


@pytest.mark.exhaustive
def test_servos_zeros_and_clamps_of_another_emio_are_found_within_their_intervals(drawn_rng):
    scene = load_scene(SCENE)
    truth = planted(drawn_rng, scene)
    poses = poses_of(changed_scene(scene, truth), drawn_rng, 24)
    found = calibrate(scene, poses, [*KEYS, *WAYS, *CLAMPS])
    true = np.array([truth["beams[0].material.young_modulus"]] + [
        truth[key] for key in (*(f"hinge_motors[{leg}].offset" for leg in range(4)), *WAYS, *CLAMPS)])
    off, _ = off_and_widths(found.joint, true)
    # Poses that happen to lie together tell little of how soft the strips are, as they only shift the hub.
    assert all("young_modulus" in key for group in found.not_told for key in group)
    # One of twenty is outside of its interval; errors of neighbours belong together.
    assert np.abs(off).max() < 2.0


@pytest.mark.exhaustive
def test_the_ways_of_the_servos_are_found_within_their_intervals(drawn_rng):
    scene, ways = load_scene(SCENE), dict(zip(WAYS, (-0.1155, -0.1155, 0.1155, 0.1155), strict=True))
    found = calibrate(scene, poses_of(changed_scene(scene, ways), drawn_rng, 8), WAYS)
    off, widths = off_and_widths(found.estimate, np.array(list(ways.values())))
    assert np.abs(off).max() < 2.0 and widths.max() < 0.1155 - 0.11494  # what they were off
