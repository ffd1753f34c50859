"""Poses of a simulated device, as a person would drive them to calibrate its twin."""

from __future__ import annotations

import numpy as np

from softrobot_twin.control.rest_watch import RestPose
from softrobot_twin.harness.equilibrium import bring_to_rest
from softrobot_twin.simulation import FollowTargets, Simulation

STEPS = 10
"""Steps of the twin to a target, of which each takes any time."""


def poses_of_device(
    twin: Simulation, device: Simulation, box: np.ndarray, count: int, noise: float, seed: int
) -> list[RestPose]:
    """Where a camera sees the markers of a device at rest, at setpoints that lead the twin through a box.

    Args:
        twin: Its twin, whose first effector is led; it is at rest afterwards.
        device: The device, with the same actuators and markers; also at rest afterwards.
        box: Least and greatest place of targets [m], shape (2, 3).
        count: Number of poses; those at which a robot does not come to rest are left out.
        noise: Standard deviation of measured places [m].
        seed: Seed of noise and targets.
    """
    from scipy.stats import qmc  # it loads slowly

    rng, poses = np.random.default_rng(seed), []
    names, efforts = device.effector_names, np.full(device.actuators.count, np.nan)
    for place in box[0] + qmc.Halton(3, seed=seed).random(count) * np.diff(box, axis=0)[0]:
        twin.reset()
        targets = twin.effector_positions()
        targets[0] = place
        for _ in range(STEPS):
            twin.step(FollowTargets(targets, 1.0))
        setpoints = twin.state.setpoints.copy()
        device.reset()
        if not bring_to_rest(device, setpoints).is_reached:
            continue
        markers = device.scene.marker_frame.of_cameras(device.marker_positions())
        poses.append(RestPose(
            setpoints, markers + noise * rng.normal(size=markers.shape), np.full((len(names), 3), np.nan),
            efforts, np.zeros((len(twin.touch_names), 3)), f"pose {len(poses) + 1}"))  # fmt: skip
    for one in (twin, device):
        one.reset()
    return poses
