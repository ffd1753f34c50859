"""A finger of silicone bends to three places; one sees what its two cables do, and a picture.

The tip is told where to go; the twin finds the lengths of the cables. Prints a line for each target
and writes ``finger.png``. Needs matplotlib:

    python examples/finger.py
"""

from pathlib import Path

import softrobot_twin as st

ROOT = Path(__file__).resolve().parents[1]

finger = st.load(ROOT / "config/scenes/finger.yaml")
print(finger)

for place in ([0.095, 0.0, 0.010], [0.090, 0.0, -0.030], [0.065, 0.0, -0.048]):  # m
    result = finger.settle(st.targets(tip=place))
    print(
        f"tip at {1e3 * result.tip[0]:.1f}, {1e3 * result.tip[2]:.1f} mm: "
        f"flexor {1e3 * result['flexor_shortening_m']:5.1f} mm, {result['flexor_tension_N']:.1f} N; "
        f"extensor {1e3 * result['extensor_shortening_m']:5.1f} mm, "
        f"{result['extensor_tension_N']:.1f} N; {result.status.value}"
    )

print(finger.jacobian("tip"))  # motion of the tip by one metre of each cable
finger.plot("finger.png")
