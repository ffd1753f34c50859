"""A trunk is led around a circle at 60 % of its first frequency: as if it stood, and by prediction.

The "real" trunk is 5 % softer; a camera sees it. Writes ``fast_trunk.png``. Needs matplotlib:

    python examples/fast_trunk.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import yaml

import softrobot_twin as st
from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.twin_loop import CommandEfforts, LoopSettings, TwinLoop

SCENES = Path(__file__).resolve().parents[1] / "config/scenes"
TICK, RADIUS, FREQUENCY, AHEAD = 0.02, [0.02, 0.02, 0.0], 1.43, 0.02 * np.arange(35)  # s, m, Hz, s
MOVES = {"gravity": [0, 0, 9.81], "integration": "dynamic", "time_scheme": "generalized_alpha"}


def trunk(young_modulus, **changes):
    """The Trunk hangs at rest, pulled with 1 N by each of its four long cables, without the others."""
    scene = yaml.safe_load((SCENES / "trunk.yaml").read_text()) | MOVES | changes
    body, scene["cables"], scene["effectors"][0]["directions"] = scene["body"], scene["cables"][:1], "xy"
    body["mesh"]["file"], body["damping"] = SCENES / body["mesh"]["file"], {"stiffness": 2e-3}
    body["material"]["young_modulus"], body["fixed"] = young_modulus, [{"box": body.pop("attached")[0]["box"]}]
    del scene["cables"][0]["pull_point_on"], scene["cables"][0]["rate"], scene["slides"], scene["rigid_bodies"]
    robot = st.build(**scene, solver={"newton_iterations": 6})
    robot.settle(st.efforts({f"L{i}_tension_N": 1.0 for i in range(4)}), time_step=0.5, most_steps=200)
    return robot.simulation


def tip_path(law):
    """Where the real tip goes, and where it shall be [m], shape (n, 2, 2)."""
    twin = trunk(450e3, control={"law": law, "inputs": "efforts", "around": [1, 1, 1, 1], "horizon": 0.5})
    real, centre, random, places = trunk(428e3), twin.effector_positions()[0], np.random.default_rng(1), []
    loop = TwinLoop(twin, LoopSettings(rate=50.0, closed_loop=True))
    loop.continue_from(twin.state.setpoints, twin.state.efforts, {})
    for now in TICK * np.arange(round(4.0 / FREQUENCY / TICK)):
        turns = FREQUENCY * (now + AHEAD)[:, None]
        circle = np.minimum(1.0, turns) * np.sin(2 * np.pi * turns + [0.0, 0.5 * np.pi, 0.0]) * RADIUS + centre
        header = Arrival("base_link", round(1e9 + 1e9 * now), round(1e9 + 1e9 * now), now)
        noise = random.normal(0.0, 1e-4, (16, 3))
        loop.markers.accept(twin.marker_ids, real.marker_positions() + noise, header)
        loop.targets.accept_path(0, AHEAD, circle, header)
        real.step(CommandEfforts(loop.tick(now, header.ros_time).command.efforts, TICK))
        places.append((real.effector_positions()[0], circle[1]))
    return 1e3 * np.array(places)[..., :2]


figure, axes = plt.subplots(1, 2, figsize=(8, 4.2), layout="constrained", sharex=True, sharey=True)
paths = {law: tip_path(law).transpose(1, 2, 0) for law in ("quasi_static", "dynamic")}
for panel, (law, (real, wanted)) in zip(axes, paths.items()):
    panel.plot(*wanted, "k--", *real)
    error = np.sqrt(((real - wanted)[:, 50:] ** 2).sum(axis=0).mean())
    panel.set(title=f"{law}: RMS {error:.1f} mm", xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
plt.savefig("fast_trunk.png", dpi=90)
