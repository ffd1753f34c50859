"""An arm of four muscles reaches a place, stiffens its root, and bears the pull of a magnet.

The twin finds the activation of each muscle. Then the modulus of the lower half of the arm grows tenfold,
and the magnet moves the tip less. A strip of a memory alloy curls beside it. Writes ``muscular_arm.png``. Needs matplotlib:

    python examples/muscular_arm.py
"""

import numpy as np

import softrobot_twin as st

SIDE, HEIGHT = 0.02, 0.12  # m
LOW = {"minimum": [-1, -1, -1], "maximum": [1, 1, HEIGHT / 2]}
QUARTERS = {"east_north": (1, 1), "west_north": (-1, 1), "west_south": (-1, -1), "east_south": (1, -1)}


def quarter(x, y):
    ends = [sorted((SIDE / 2, SIDE / 2 + sign)) for sign in (x, y)]
    return {"minimum": [ends[0][0], ends[1][0], -1], "maximum": [ends[0][1], ends[1][1], 1]}


arm = st.build(
    name="muscular_arm",
    bodies=[{
        "name": "arm", "mesh": {"box": {"size": [SIDE, SIDE, HEIGHT], "cells": [2, 2, 8]}},
        "material": {"young_modulus": 100e3, "poisson_ratio": 0.45, "density": 1000.0},
        "materials": [{"box": LOW, "young_modulus": 100e3}],
        "fixed": [{"box": {"minimum": [-1, -1, -1], "maximum": [1, 1, 1e-6]}}],
    }],
    beams=[{
        "name": "strip", "points": [[0.06, 0.01, 0.0], [0.06, 0.01, HEIGHT]], "elements": 12,
        "section": {"rectangle": {"thickness": 0.001, "width": 0.008}}, "fixed": ["start"],
        "thickness_direction": [1, 0, 0],
        "material": {"young_modulus": 30e9, "poisson_ratio": 0.3, "density": 6500.0},
    }],
    muscles=[{"name": name, "body": "arm", "box": quarter(*signs), "direction": [0, 0, 1], "stress": 60e3,
              "free_contraction": 0.4, "rate": 2.0} for name, signs in QUARTERS.items()],
    stiffeners=[{"name": "jam", "body": "arm", "box": LOW, "young_modulus": [50e3, 1e6]}],
    rest_shapes=[{"name": "curl", "beam": "strip", "bend": [0.0, 5.0]}],
    forces=[{"name": "magnet", "body": "arm", "points": [[SIDE / 2, SIDE / 2, HEIGHT]],
             "direction": [0, 1, 0], "force": [-0.2, 0.2]}],
    effectors=[{"name": "tip", "body": "arm", "points": [[SIDE / 2, SIDE / 2, HEIGHT]]}],
)  # fmt: skip
held = {"jam_young_modulus_Pa": 100e3, "magnet_force_N": 0.0, "curl_rest_bend_rad": 4.0}
reached = arm.settle(st.targets(tip=[0.04, 0.02, 0.1], **held))
activations = {f"{name}_activation": reached[f"{name}_activation"] for name in QUARTERS}
print("activations:", {name: round(float(value), 2) for name, value in activations.items()})
arm.plot("muscular_arm.png", view=(15, -70))

yields = {}
for modulus in (100e3, 1e6):
    tips = [arm.settle(st.setpoints(jam_young_modulus_Pa=modulus, magnet_force_N=force)).tip
            for force in (0.0, 0.02)]  # fmt: skip
    yields[modulus] = 1e3 * np.linalg.norm(tips[1] - tips[0])
    print(f"E {1e-3 * modulus:.0f} kPa: the magnet moves the tip by {yields[modulus]:.2f} mm")
