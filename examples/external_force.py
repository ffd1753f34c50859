"""A Diamond is pushed by nobody knows what: cameras see markers, and the force is found from them.

The "real" robot is pushed aside at its tip, and its eight markers are seen with noise. The twin finds
the force and bears it: it stands where the real robot is. One sees the force settle in a few frames,
inside two standard deviations. Writes ``external_force.png``. Needs matplotlib:

    python examples/external_force.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import softrobot_twin as st

ROOT = Path(__file__).resolve().parents[1]
NOISE, PUSH = 0.1e-3, [0.8, 0.6, 0.0]  # m, N

scene = ROOT / "config/scenes/diamond.yaml"
twin = st.load(scene, {"observer": {}})  # one force at each effector: here at the tip
real = st.load(scene, {"touches": [{"name": "hand", "points": [[0.0, 0.0, 0.125]]}]})
random = np.random.default_rng(1)
for robot in (twin, real):
    robot.settle()

forces, deviations = [], []
for frame in range(20):
    touches = {"hand_force_N": PUSH} if frame >= 5 else {}
    real.settle(touches=touches)
    seen = real.simulation.marker_positions() + random.normal(0.0, NOISE, (8, 3))
    tip = twin.observe(seen, noise=NOISE)["tip"]
    forces.append(tip.force)
    deviations.append(tip.deviations[:3])
    twin.step()  # under this force
print(f"found {np.round(forces[-1], 2)} N, of {PUSH} N")

plt.figure(figsize=(6, 4), layout="constrained")
for axis, forces_of, spread in zip("xyz", np.array(forces).T, np.array(deviations).T):
    plt.errorbar(range(20), forces_of, 2.0 * spread, capsize=2.0, label=axis)
plt.legend()
plt.xlabel("frame")
plt.ylabel("force at the tip, with two deviations [N]")
plt.savefig("external_force.png", dpi=100)
