"""Materials by name: laws fitted to published tensile curves.

`material_presets.json` holds the table; `tools/fit_presets.py` makes the constants and errors in it
from its curves and prints them.
A law is fitted to engineering stresses by least squares of the relative error, over the strains of
the table. A tensile test says nothing of compression beyond the lateral contraction at its end, nor
of equal stretches in two directions; nor of how a batch, its cure or its age differ: silicones of
one name differ by more than the errors below.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

POISSON_RATIO = 0.49
"""Of all presets: rubber keeps its volume. Nearer to 0.5, linear elements lock more."""


class MaterialPreset(NamedTuple):
    """A material, the curve it was fitted to, and how well.

    Attributes:
        law: Name of its law.
        constants: Constants of the law [Pa].
        density: [kg/m³], as its maker states it.
        rms_error: Root mean square of the relative error of the stress over the curve.
        largest_error: The largest.
        curve: Engineering strains and stresses [MPa], a pair each, from the smallest strain on: below it,
            the law is extrapolated.
        source: Where the curve was published.
    """

    law: str
    constants: dict[str, float]
    density: float
    rms_error: float
    largest_error: float
    curve: tuple[tuple[float, float], ...]
    source: str

    @property
    def largest_strain(self) -> float:
        """Engineering strain up to which it was fitted."""
        return self.curve[-1][0]

    @property
    def strain_range(self) -> tuple[float, float]:
        """Principal strains of the test: from the lateral contraction at its end to its end.

        It holds the strains below the first of the data, which every body passes.
        """
        return ((1.0 + self.largest_strain) ** -0.5 - 1.0, self.largest_strain)


def _presets() -> dict[str, MaterialPreset]:
    table = json.loads(Path(__file__).with_suffix(".json").read_text())
    for entry in table.values():
        entry["curve"] = tuple(map(tuple, entry["curve"]))
    return {name: MaterialPreset(**entry) for name, entry in table.items()}


MATERIAL_PRESETS = _presets()
UNFITTED = {
    "elastosil_m4601": "no published tensile curve was found; constants of Yeoh's law c1 0.11 MPa, "
                       "c2 0.02 MPa, c3 0 are in use, without an error or a range of strains",
    "smooth_sil_950": "no published tensile curve was found; its maker states one stress only",
}  # fmt: skip
"""Materials that a scene may ask for by name and that are refused, with the reason."""
