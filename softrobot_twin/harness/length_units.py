"""Units of lengths that files and users state, and those in which results are told."""

import math

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Metres in each unit."""
SHOWN = {"m": (1e3, "mm"), "m3": (1e6, "cm³"), "Pa": (1e-3, "kPa"), "Nm": (1.0, "N m"),
         "rad": (180.0 / math.pi, "°"), "N_per_m": (1.0, "N/m"), "m_per_N": (1.0, "m/N"),
         "s": (1e3, "ms")}  # fmt: skip
"""Factor and unit in which a unit of a column is told and drawn."""
