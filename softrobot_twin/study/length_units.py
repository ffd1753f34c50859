"""Units of lengths: of files that do not state theirs, and of sizes that users type."""

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254}
"""Metres in each unit."""
