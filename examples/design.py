"""Where the cable of a finger shall run, so that its tip passes wanted places.

The heights of the lower cable near the base and near the tip, and the modulus of the silicone, are found
by `Robot.optimise`; what the places cannot tell is printed. Writes ``design.png`` and ``designed.yaml``,
the scene with these numbers. Needs matplotlib:

    python examples/design.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import softrobot_twin as st

finger = st.load(Path(__file__).resolve().parents[1] / "config/scenes/finger.yaml")
commands = [st.setpoints(flexor_shortening_m=pull) for pull in (0.004, 0.008, 0.012, 0.016)]
wanted = [(0.095, 0.0, -0.0205), (0.086, 0.0, -0.0335), (0.075, 0.0, -0.043), (0.063, 0.0, -0.0485)]  # m
heights = [f"cables.flexor.points[{place}][2]" for place in range(6)]

design = finger.optimise(
    [(command, {"tip": place}) for command, place in zip(commands, wanted)],
    {
        "near the base": dict.fromkeys(heights[:3], 1.0),  # moved together, from where they are
        "near the tip": dict.fromkeys(heights[3:], 1.0),
        "modulus": "body.material.young_modulus",
    },
    {"near the base": (-0.003, 0.003), "near the tip": (-0.003, 0.003), "modulus": (300e3, 800e3)},
)
print(design)
design.write("designed.yaml")


def tips(robot):
    """Where the tip is at each command [mm]."""
    robot.reset()
    return 1e3 * np.array([robot.settle(command).tip for command in commands])


plt.figure(figsize=(6, 4), layout="constrained")
for robot, style, label in ((finger, "s:", "as it is"), (st.load("designed.yaml"), "o-", "as designed")):
    places = tips(robot)
    plt.plot(places[:, 0], places[:, 2], style, label=label)
plt.plot(*(1e3 * np.array(wanted)[:, [0, 2]].T), "k+", markersize=14, label="wanted")
plt.xlabel("x of the tip [mm]")
plt.ylabel("z of the tip [mm]")
plt.axis("equal")
plt.legend()
plt.savefig("design.png", dpi=100)
