"""A finger that is not its model follows a circle: open loop, then with a camera.

The "real" finger is another model: finer, 15 % softer, its cables 0.5 mm off. A camera sees its tip
with noise. In closed loop an integrator moves the target by what the camera sees of the error. One
sees the mean error fall to a quarter. Writes ``closed_loop.png``. Needs matplotlib:

    python examples/closed_loop.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import softrobot_twin as st

ROOT = Path(__file__).resolve().parents[1]
TIME_STEP, PERIOD = 0.05, 3.0  # s
GAIN = 5.0  # 1/s, of the integrator
NOISE = 0.1e-3  # m, of the camera

twin = st.load(ROOT / "config/scenes/finger.yaml")
real = st.load(ROOT / "config/scenes/finger_device.yaml")
random = np.random.default_rng(1)
times = np.arange(0.0, 3.0 * PERIOD, TIME_STEP)
closes = PERIOD  # s: one round open, two closed
correction, errors = np.zeros(3), []


def circle(time):
    """The target [m]."""
    angle = 2.0 * np.pi * time / PERIOD
    return np.array([0.084 + 0.008 * np.cos(angle), 0.0, -0.024 - 0.008 * np.sin(angle)])


twin.settle(st.targets(tip=circle(0.0)))

for time in times:
    target = circle(time)
    planned = twin.step(st.targets(tip=target + correction), time_step=TIME_STEP)
    cables = {name: planned[name] for name in ("flexor_shortening_m", "extensor_shortening_m")}
    reached = real.step(st.setpoints(cables), time_step=TIME_STEP).tip
    seen = reached + random.normal(0.0, NOISE, 3)
    if time >= closes:
        correction += GAIN * TIME_STEP * (target - seen) * (1.0, 0.0, 1.0)  # the plane of the cables
    errors.append(1e3 * np.linalg.norm((reached - target)[[0, 2]]))

errors = np.array(errors)
is_open, is_closed = (times > 1.0) & (times < closes), times > closes + 1.0
print(f"mean error: {errors[is_open].mean():.2f} mm open, {errors[is_closed].mean():.2f} mm closed")

plt.figure(figsize=(6, 4), layout="constrained")
plt.plot(times, errors)
plt.axvline(closes, color="0.5", linestyle="--")
plt.text(closes, 1.3, "  the loop is closed")
plt.ylim(0.0, 1.5)
plt.xlabel("time [s]")
plt.ylabel("distance of the real tip from its target [mm]")
plt.savefig("closed_loop.png", dpi=100)
