"""A policy that learned on reduced models runs on the full model and on the simulated device.

The device is finer, softer, its cables attached 1 mm aside; commands come late, noisy markers see its
tip. Writes ``policy_on_device.png``; ``many_robots.py`` is run first where it left no ``policy.csv``:

    python examples/policy_on_device.py
"""

import runpy
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from softrobot_twin.control.simulated_device import DeviceFlaws, SimulatedDevice
from softrobot_twin.scene import load_scene
from softrobot_twin.scripting.gym_environment import ReachingEnvironment
from softrobot_twin.scripting.robot import Robot

ROOT = Path(__file__).resolve().parents[1]
REDUCED, DEVICE = (ROOT / f"config/scenes/diamond_{name}.yaml" for name in ("reduced", "device"))
STEPS, STEP, SCALES = 12, 0.1, np.repeat([1.0, 30.0, 1.0], [4, 6, 1])  # STEP: s


def missed(scene, policy, targets, **flaws):
    """How far the tip of a robot is from each target in the end [mm]."""
    body, far = Robot(scene).simulation, []
    least, most = body.limits.drive_min, body.limits.drive_max
    for seed, target in enumerate(targets):
        body.reset()
        robot, wound = SimulatedDevice(body, DeviceFlaws(**flaws, seed=seed)), np.zeros(4)
        start = robot.read(0.0).marker_positions[4:].mean(axis=0)
        for time in STEP * np.arange(STEPS + 1):
            told = robot.read(time)
            tip = told.marker_positions[4:].mean(axis=0)  # of the four around it
            shares = (body.actuators.drives(told.setpoints) - least) / (most - least)
            places = np.concatenate([tip - start, target - tip]) / body.model.nodes.size
            seen = SCALES * np.concatenate([2.0 * shares - 1.0, places, [1.0]])
            speeds = body.limits.rate * np.clip(seen @ policy, -1.0, 1.0)
            wound = np.clip(wound + STEP * speeds, least, most)  # m
            robot.apply(body.actuators.setpoints(wound), time)
        far.append(1e3 * np.linalg.norm(body.effector_positions()[0] - target))
    return np.array(far)


if __name__ == "__main__":
    if not Path("policy.csv").is_file():
        runpy.run_path(str(ROOT / "examples/many_robots.py"), run_name="__main__")
    policy, model = np.loadtxt("policy.csv", delimiter=","), ReachingEnvironment(REDUCED, travel=0.3)
    targets = [model.reset(seed=seed) and model.target for seed in range(20)]
    found = {"no policy": missed(load_scene(REDUCED), 0.0 * policy, targets),
             "reduced model": missed(load_scene(REDUCED), policy, targets),
             "full model": missed(load_scene(REDUCED, {"body.reduced": None}), policy, targets),
             "device": missed(load_scene(DEVICE), policy, targets, delay=0.02, marker_noise=1e-4)}
    for name, far in found.items():
        print(f"{name}: {far.mean():.2f} mm from 20 targets, {far.max():.2f} at most")
    plt.figure().subplots().bar(list(found), [far.mean() for far in found.values()])
    plt.ylabel("distance to targets in the end [mm]")
    plt.savefig("policy_on_device.png", dpi=100)
