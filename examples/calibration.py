"""Young's modulus of a finger, found from how far it sags: calibration by hand.

Without its cables a finger bends under its own weight, and under a weight that hangs from its tip. A
"real" finger, simulated with a modulus that the fit does not know, is measured with an error of 0.1
mm; scipy finds the modulus that explains it. Writes ``calibration.png``. Needs matplotlib:

    python examples/calibration.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize_scalar

import softrobot_twin as st

ROOT = Path(__file__).resolve().parents[1]
WEIGHTS = np.array([0.0, 0.05, 0.10, 0.15])  # N


def sags(young_modulus):
    """Height of the tip under each weight [m]; a scene needs no file."""
    finger = st.build(
        name="finger",
        gravity=[0.0, 0.0, -9.81],
        body={
            "mesh": {"file": ROOT / "meshes/finger_99.msh"},
            "material": {"young_modulus": young_modulus, "poisson_ratio": 0.45, "density": 1070.0},
            "fixed": [{"box": {"minimum": [-0.001, -0.01, -0.011], "maximum": [0.001, 0.01, 0.011]}}],
        },
        effectors=[{"name": "tip", "points": [[0.1, 0.0, 0.0]]}],
        touches=[{"name": "weight", "points": [[0.095, 0.0, 0.0]]}],
    )
    hang = [{"weight_force_N": [0.0, 0.0, -weight]} for weight in WEIGHTS]
    return np.array([finger.settle(touches=force).tip[2] for force in hang])


random = np.random.default_rng(1)
measured = sags(437e3) + random.normal(0.0, 0.1e-3, WEIGHTS.shape)  # the "real" finger

fit = minimize_scalar(
    lambda modulus: np.sum((sags(modulus) - measured) ** 2),
    bounds=(200e3, 1000e3), method="bounded", options={"xatol": 200.0},
)  # fmt: skip
print(f"Young's modulus {1e-3 * fit.x:.0f} kPa after {fit.nfev} tries; the finger has 437 kPa")

plt.figure(figsize=(6, 4), layout="constrained")
plt.plot(WEIGHTS, 1e3 * measured, "ko", label="measured")
plt.plot(WEIGHTS, 1e3 * sags(500e3), ":", label="500 kPa, from the data sheet")
plt.plot(WEIGHTS, 1e3 * sags(fit.x), label=f"fitted, {1e-3 * fit.x:.0f} kPa")
plt.xlabel("weight at the tip [N]")
plt.ylabel("height of the tip [mm]")
plt.legend()
plt.savefig("calibration.png", dpi=100)
