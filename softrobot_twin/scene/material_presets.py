"""Materials by name: laws fitted to published tensile curves.

`tools/fit_presets.py` makes the constants and errors of this table from its curves and prints them.
A law is fitted to engineering stresses by least squares of the relative error, over the strains of
the table. A tensile test says nothing of compression beyond the lateral contraction at its end, nor
of equal stretches in two directions; nor of how a batch, its cure or its age differ: silicones of
one name differ by more than the errors below.
"""

from __future__ import annotations

from typing import NamedTuple

DATABASE = (
    "Soft Robotics Materials Database (Marechal et al. 2021), ASTM D412, 450 mm/min, "
    "crosshead strain"
)
SOROFORGE = "Smith and MacCurdy 2023 (SoRoForge, NinjaFlex, printed), uniaxial, mean of 8 specimens"
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
        curve: Engineering strains and stresses [MPa], a pair each.
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
    def smallest_strain(self) -> float:
        """Engineering strain from which on there are data: below it, the law is extrapolated."""
        return self.curve[0][0]

    @property
    def strain_range(self) -> tuple[float, float]:
        """Principal strains of the test: from the lateral contraction at its end to its end.

        It holds the strains below the first of the data, which every body passes.
        """
        return ((1.0 + self.largest_strain) ** -0.5 - 1.0, self.largest_strain)


MATERIAL_PRESETS = {
    "dragon_skin_10": MaterialPreset(
        "yeoh", {"c1": 20804.0, "c2": 2682.7, "c3": 0.0}, 1070.0, 0.036, 0.057,
        ((0.09084, 0.01013), (0.13636, 0.014787), (0.25, 0.026427), (0.5, 0.052997),
         (0.75, 0.082293), (1.0, 0.112963), (1.25, 0.14983), (1.5, 0.190583)),
        DATABASE,
    ),
    "dragon_skin_20": MaterialPreset(
        "yeoh", {"c1": 55797.0, "c2": 7625.2, "c3": 0.0}, 1080.0, 0.067, 0.096,
        ((0.09084, 0.026063), (0.13636, 0.03898), (0.25, 0.072147), (0.5, 0.151073),
         (0.75, 0.232767), (1.0, 0.31836), (1.25, 0.41047), (1.5, 0.509237)),
        DATABASE,
    ),
    "dragon_skin_30": MaterialPreset(
        "yeoh", {"c1": 86981.0, "c2": 8369.8, "c3": 0.0}, 1080.0, 0.040, 0.055,
        ((0.09084, 0.041493), (0.13636, 0.061803), (0.25, 0.110873), (0.5, 0.213917),
         (0.75, 0.32207), (1.0, 0.437123), (1.25, 0.56021), (1.5, 0.689383)),
        DATABASE,
    ),
    "ecoflex_00_30": MaterialPreset(
        "yeoh", {"c1": 7061.7, "c2": 237.75, "c3": 0.0}, 1070.0, 0.050, 0.083,
        ((0.09084, 0.00343), (0.13636, 0.00483), (0.25, 0.00856), (0.5, 0.01689),
         (0.75, 0.02288), (1.0, 0.02972), (1.25, 0.03451), (1.5, 0.04008)),
        DATABASE,
    ),
    "ecoflex_00_50": MaterialPreset(
        "yeoh", {"c1": 9540.6, "c2": 461.87, "c3": 0.0}, 1070.0, 0.049, 0.080,
        ((0.09084, 0.004435), (0.13636, 0.00668), (0.25, 0.01226), (0.5, 0.022775),
         (0.75, 0.03207), (1.0, 0.04095), (1.25, 0.05038), (1.5, 0.05951)),
        DATABASE,
    ),
    "tpu_85a": MaterialPreset(
        "mooney_rivlin", {"c10": 447710.0, "c01": 2561600.0}, 1190.0, 0.013, 0.019,
        ((0.31303, 3.5616), (0.62605, 5.0554), (0.93908, 5.8419), (1.25211, 6.4158),
         (1.56514, 6.9536), (1.87816, 7.5234)),
        SOROFORGE,
    ),
}  # fmt: skip

UNFITTED = {
    "elastosil_m4601": "no published tensile curve was found; constants of Yeoh's law c1 0.11 MPa, "
                       "c2 0.02 MPa, c3 0 are in use, without an error or a range of strains",
    "smooth_sil_950": "no published tensile curve was found; its maker states one stress only",
}  # fmt: skip
"""Materials that a scene may ask for by name and that are refused, with the reason."""
