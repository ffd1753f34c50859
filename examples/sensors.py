"""A finger bends to an angle that is wanted of its bend sensor, not to a place.

A string beside its middle and the reaction at its foot are read on the way. Writes ``sensors.png``.
Needs matplotlib:

    python examples/sensors.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import softrobot_twin as st

ROOT = Path(__file__).resolve().parents[1]
LINE = [[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.07, 0.0, 0.0], [0.095, 0.0, 0.0]]  # m

finger = st.load(ROOT / "config/scenes/finger.yaml", {
    "sensors": [
        {"name": "flex", "bend": LINE, "axis": [0.0, 1.0, 0.0], "weight": 1.0},
        {"name": "spine", "string": [[x, 0.0, 0.006] for x, _, _ in LINE]},
    ],
    "reactions": [{"name": "foot", "of": "body"}],
})  # fmt: skip

angles = np.linspace(0.0, 0.6, 13)  # rad
results = [finger.settle(st.targets(flex_angle_rad=angle)) for angle in angles]
shown, string, moment, tension = (
    np.array([result[name] for result in results])
    for name in ("flex_angle_rad", "spine_length_m", "foot_reaction_torque_y_Nm", "flexor_tension_N")
)
print(f"wanted to {np.abs(shown - angles).max():.0e} rad, the string grows by "
      f"{1e3 * (string[-1] - string[0]):.1f} mm")  # fmt: skip

figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(6, 5), layout="constrained")
above.plot(angles, 1e3 * string)
above.set_ylabel("string [mm]")
below.plot(angles, tension, label="tension [N]")
below.plot(angles, 1e3 * moment, label="moment at the foot [N mm]")
below.set_xlabel("wanted angle [rad]")
below.legend()
figure.savefig("sensors.png", dpi=100)
