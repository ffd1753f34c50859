"""Three soft fingers hold a cube by friction and lead it along a circle in their grip.

The Grasper without its motor: three cables follow targets of the cube while the palm rises. One sees
the cube on the circle, and what share of its friction each finger has left. Writes ``in_hand.png`` and
``in_hand_end.png``. Needs matplotlib; takes some seconds:

    python examples/in_hand.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import yaml

import softrobot_twin as st

ROOT = Path(__file__).resolve().parents[1]
TIME_STEP, GRIP, RADIUS = 0.02, 0.018, 0.001  # s, m, m

entries = yaml.safe_load((ROOT / "config/scenes/grasper.yaml").read_text())
entries["bodies"][0]["mesh"]["file"] = str(ROOT / "meshes/grasper_finger_158.vtk")
entries["contact"]["between"][0]["least_grip_margin"] = 0.05
del entries["motors"]  # each cable has a winch of its own
hand = st.build(**entries)

closed = st.setpoints({f"{name}_shortening_m": GRIP for name in hand.actuator_names})
for _ in range(60):
    hand.step(closed, time_step=TIME_STEP)
for _ in range(90):
    hand.step(closed, time_step=TIME_STEP, poses={"palm": [0.0, 0.0, 0.020]})

start, angles = hand.effectors["cube"].copy(), np.linspace(0.0, 2.0 * np.pi, 400)
turned = np.stack([np.cos(angles) - 1.0, np.sin(angles), 0.0 * angles], axis=1)
lift = np.clip(np.arange(400) / 300, 0.0, 1.0)[:, None] * [0.0, 0.0, 0.030]
places, margins = [], []
for target, rise in zip(start + RADIUS * turned + lift, lift, strict=True):
    result = hand.step(
        st.targets(cube=target), time_step=TIME_STEP, poses={"palm": rise + [0.0, 0.0, 0.020]}
    )
    places.append(hand.effectors["cube"].copy())
    margins.append([*result.report.figures.values()])
errors = 1e3 * np.linalg.norm(places - (start + RADIUS * turned + lift), axis=1)
print(f"the cube is at most {errors.max():.3f} mm from its target, {errors[-1]:.3f} mm at the end")

figure, (above, beside) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
above.plot(*(1e3 * RADIUS * turned[:, :2].T), "k--", label="target")
above.plot(*(1e3 * (np.array(places) - start)[:, :2].T), label="cube")
above.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
above.legend()
beside.plot(TIME_STEP * np.arange(400), margins, label=["finger 0", "finger 1", "finger 2"])
beside.set(xlabel="time [s]", ylabel="share of the friction that is left")
beside.legend()
figure.savefig("in_hand.png", dpi=100)
hand.plot("in_hand_end.png", view=(14, -50))
