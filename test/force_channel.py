"""A channel in one file, as a user would write it: load cells at the pulleys of cables.

The model tells the force on each cell, and the twin takes what the cells measure.
"""

import numpy as np

from softrobot_twin.tables.channels import Channel

LEVER = 0.25
"""A cell carries this share of the tension, along one axis and against the other."""

FORCE = Channel(
    name="force", unit="N", objects="actuator_names", parts=("along", "across"),
    columns=lambda name: (f"{name}_force_along_N", f"{name}_force_across_N"),
    read=lambda result: np.outer(result.efforts, [LEVER, -LEVER]), most=50.0,
)  # fmt: skip
