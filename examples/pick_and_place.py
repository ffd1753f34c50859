"""A finger on an arm takes a cube by a suction cup, carries it, and lets go.

The arm is `moving_base`: it moves sideways and stops, and the cube swings under the finger. Writes
``pick_and_place.png``. Needs matplotlib:

    python examples/pick_and_place.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import softrobot_twin as st

ROOT = Path(__file__).resolve().parents[1]
STEP, SIDE = 0.004, 0.15  # s, m
PAD = [[0.095, 0.003, -0.003], [0.095, -0.003, -0.003], [0.095, 0.0, 0.003]]  # m

finger = st.load(ROOT / "config/scenes/finger.yaml", {
    # The finger hangs: gravity is along its axis.
    "gravity": [9.81, 0.0, 0.0], "integration": "dynamic", "moving_base": {},
    "body.damping": {"mass": 5.0, "stiffness": 0.005},
    "rigid_bodies": [{"name": "cube", "mass": 0.01, "box": {"size": [0.016, 0.016, 0.016]},
                      "position": [0.1045, 0.0, 0.0]}],
    "solver": {"newton_iterations": 8},
    "grips": [{"name": "cup", "points": PAD, "holds": "cube", "reach": 0.003}],
})  # fmt: skip

times = STEP * np.arange(1, 301)
ways = SIDE * np.clip((times - 0.2) / 0.3, 0.0, 1.0)
ways = ways**2 * (3.0 - 2.0 * ways / SIDE) / SIDE  # smooth at both ends
places, forces = [], []
for time, way in zip(times, ways):
    result = finger.step(time_step=STEP, grips={"cup": bool(time < 1.1)}, base=[0.0, way, 0.0])
    places.append([result[f"cube_{axis}_m"] for axis in "xy"])
    forces.append(result["cup_force_x_N"])
places, swing = np.array(places), np.abs(np.array(places)[:270, 1]).max()
print(f"the cube swings by {1e3 * swing:.1f} mm, and falls by "
      f"{1e3 * (places[-1, 0] - places[270, 0]):.0f} mm when it is let go")  # fmt: skip

figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(6, 5), layout="constrained")
above.plot(times, 1e3 * ways, label="arm")
above.plot(times, 1e3 * places[:, 1], label="cube, from the arm")
above.set_ylabel("to the side [mm]")
above.legend()
below.plot(times, forces)
below.set_ylabel("force of the cup along the finger [N]")
below.set_xlabel("time [s]")
figure.savefig("pick_and_place.png", dpi=100)
