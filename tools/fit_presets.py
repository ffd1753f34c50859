"""Fits the laws of material presets to their published tensile curves, and prints the table.

Run it where a curve was added; then copy constants and errors into
`softrobot_twin/scene/material_presets.json`. A test compares them.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

from softrobot_twin.harness.terminal import console, table
from softrobot_twin.scene.material_presets import MATERIAL_PRESETS, MaterialPreset

DIGITS = 5
"""Significant digits of the fitted constants."""


class PresetFit(NamedTuple):
    """A law fitted to a curve.

    Attributes:
        constants: Its constants [Pa].
        rms_error: Root mean square of the relative error of the stress.
        largest_error: The largest.
    """

    constants: dict[str, float]
    rms_error: float
    largest_error: float


def responses(law: str, stretches: np.ndarray) -> dict[str, np.ndarray]:
    """Engineering stress of a uniaxial stretch at constant volume by 1 Pa of each constant.

    Args:
        law: Name of the law.
        stretches: λ, shape (count,).

    Returns:
        By the name of the constant, shape (count,) each.

    Raises:
        KeyError: The law has no linear fit here.
    """
    drive = 2.0 * (stretches - stretches**-2.0)
    if law == "mooney_rivlin":
        return {"c10": drive, "c01": drive / stretches}
    if law == "yeoh":
        beyond = stretches**2 + 2.0 / stretches - 3.0
        return {"c1": drive, "c2": 2.0 * beyond * drive, "c3": 3.0 * beyond**2 * drive}
    raise KeyError(law)


def stresses(law: str, constants: dict[str, float], stretches: np.ndarray) -> np.ndarray:
    """Engineering stress of a uniaxial stretch at constant volume [Pa], shape (count,)."""
    parts = responses(law, stretches)
    return sum(constants[name] * parts[name] for name in parts)


def errors(preset: MaterialPreset, constants: dict[str, float]) -> np.ndarray:
    """Relative errors of the stress over the curve, shape (count,)."""
    strains, measured = np.array(preset.curve).T
    return stresses(preset.law, constants, 1.0 + strains) / (1e6 * measured) - 1.0


def fitted(preset: MaterialPreset) -> PresetFit:
    """Fit the law of a preset to its curve."""
    strains, measured = np.array(preset.curve).T
    parts = responses(preset.law, 1.0 + strains)
    matrix = np.column_stack(list(parts.values())) / (1e6 * measured)[:, None]
    # Without negative constants the stress rises at every stretch: nothing runs away.
    found = nnls(matrix, np.ones(len(measured)))[0]
    constants = {name: float(f"{value:.{DIGITS}g}")
                 for name, value in zip(parts, found, strict=True)}  # fmt: skip
    wrong = errors(preset, constants)
    return PresetFit(
        constants, float(np.sqrt(np.mean(wrong**2))), float(np.abs(wrong).max())
    )


def main() -> int:
    """Prints the table."""
    made = table(
        "Material presets", "preset", "law", "constants [Pa]", "rms error", "largest",
        "data from strain", "to strain",
    )  # fmt: skip
    for name, preset in MATERIAL_PRESETS.items():
        fit = fitted(preset)
        constants = ", ".join(f"{key} {value:g}" for key, value in fit.constants.items())
        made.add_row(
            name, preset.law, constants, f"{100.0 * fit.rms_error:.1f} %",
            f"{100.0 * fit.largest_error:.1f} %", f"{100.0 * preset.curve[0][0]:.0f} %",
            f"{100.0 * preset.largest_strain:.0f} %",
        )  # fmt: skip
    console().print(made)
    return 0


if __name__ == "__main__":
    sys.exit(main())
