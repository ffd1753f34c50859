"""A gripper of three PneuNet fingers closes on a ball and lifts it, held by friction alone.

One valve inflates the fingers; the palm that they hang from is moved. One sees the height of the
ball, which leaves the floor, and the grip at the end. Writes two pictures,
``pneumatic_gripper.png`` and ``pneumatic_gripper_end.png``. Needs matplotlib; takes some seconds:

    python examples/pneumatic_gripper.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import softrobot_twin as st

ROOT = Path(__file__).resolve().parents[1]
RATE = 100.0  # steps a second

gripper = st.load(ROOT / "config/scenes/pneunet.yaml")
times = np.arange(0.0, 3.5, 1.0 / RATE)  # s
pressures = np.interp(times, [0.0, 1.0], [0.0, 30e3])  # Pa, gauge
lifts = np.interp(times, [1.5, 3.0], [0.0, 0.040])  # m

heights = []
for pressure, lift in zip(pressures, lifts, strict=True):
    result = gripper.step(
        st.setpoints(grip_pressure_Pa=pressure),
        poses={"palm": [0.0, 0.0, lift]},
        time_step=1.0 / RATE,
    )
    heights.append(result.poses["ball"].position[2])
heights = 1e3 * (np.array(heights) - heights[0])
print(f"the ball is {heights[-1]:.1f} mm above its place, the palm {1e3 * lifts[-1]:.1f} mm; "
      f"{len(result.contacts.forces)} contacts hold it")

plt.figure(figsize=(6, 4), layout="constrained")
plt.plot(times, 1e3 * lifts, "k--", label="palm")
plt.plot(times, heights, label="ball")
plt.xlabel("time [s]")
plt.ylabel("lift [mm]")
plt.legend()
plt.savefig("pneumatic_gripper.png", dpi=100)
gripper.plot("pneumatic_gripper_end.png", view=(14, -50))
