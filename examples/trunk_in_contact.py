"""A trunk reaches between two cylinders and leans on them where it has to.

Nine actuators follow the tip's path; contacts with the cylinders are part of the inverse problem.
One sees the tip follow its path although the body touches, and the forces of the contacts. Writes two pictures,
``trunk_in_contact.png`` and ``trunk_in_contact_end.png``. Needs matplotlib; takes some seconds:

    python examples/trunk_in_contact.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import softrobot_twin as st

ROOT = Path(__file__).resolve().parents[1]
RATE = 20.0  # steps a second

trunk = st.load(ROOT / "config/scenes/trunk_cylinders.yaml")
path = np.genfromtxt(ROOT / "config/targets/trunk_path.csv", delimiter=",", names=True)
times = np.arange(0.0, 5.0, 1.0 / RATE)  # s: in, through the gap and beyond
places = np.stack([np.interp(times, path["time_s"], path[f"tip_{axis}_m"]) for axis in "xyz"], 1)

trunk.settle(st.targets(tip=places[0]))
tips, forces = [], []
for place in places:
    result = trunk.step(st.targets(tip=place), time_step=1.0 / RATE)
    tips.append(result.tip)
    forces.append(np.linalg.norm(result.contacts.forces, axis=1).sum())
tips, forces = np.array(tips), np.array(forces)
errors = 1e3 * np.linalg.norm(tips - places, axis=1)
print(f"{len(times)} steps: the tip is {errors.mean():.2f} mm from its path, at most "
      f"{errors.max():.2f} mm; the cylinders carry up to {forces.max():.2f} N")

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
left.plot(1e3 * places[:, 0], 1e3 * places[:, 2], "k--", label="path")
left.plot(1e3 * tips[:, 0], 1e3 * tips[:, 2], label="tip")
for x in (-5.0, 45.0):
    left.add_patch(plt.Circle((x, 212.0), 15.0, color="0.8"))
left.set(xlabel="x [mm]", ylabel="z [mm]", aspect="equal")
left.legend()
right.plot(times, forces)
right.set(xlabel="time [s]", ylabel="forces of the cylinders [N]")
figure.savefig("trunk_in_contact.png", dpi=100)
trunk.plot("trunk_in_contact_end.png", view=(12, -75))
