"""A finger presses a plate as hard as is wanted: its target is a contact force, not a place.

Writes ``pressing_finger.png``. Needs matplotlib:

    python examples/pressing_finger.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import softrobot_twin as st

ROOT = Path(__file__).resolve().parents[1]

# Within the alarm distance the finger finds the plate, which is 20 mm below it.
finger = st.load(ROOT / "config/scenes/finger.yaml", {
    "obstacles": [{"name": "plate", "box": {"size": [0.1, 0.1, 0.01]}, "position": [0.08, 0.0, -0.035]}],
    "contact": {"between": [{"pair": ["body", "plate"]}], "alarm_distance": 0.05},
    "sensors": [{"name": "touch", "contact": ["body", "plate"], "full_scale": 1.0, "weight": 1.0}],
})  # fmt: skip

wanted = np.linspace(0.02, 0.3, 15)  # N
results = [finger.settle(st.targets(touch_force_N=force)) for force in wanted]
felt, tension, height = (np.array([result[name] for result in results])
                         for name in ("touch_force_N", "flexor_tension_N", "tip_z_m"))  # fmt: skip
print(f"wanted to {np.abs(felt - wanted).max():.0e} N, the tip moves by {1e3 * np.ptp(height):.1f} mm")

figure, (above, below) = plt.subplots(2, 1, sharex=True, figsize=(6, 5), layout="constrained")
above.plot(wanted, felt, "o-")
above.set_ylabel("force on the plate [N]")
below.plot(wanted, tension)
below.set_ylabel("tension of the flexor [N]")
below.set_xlabel("wanted force [N]")
figure.savefig("pressing_finger.png", dpi=100)
