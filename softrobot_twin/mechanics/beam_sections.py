"""Cross-sections of beams: areas and moments that their stiffness and mass follow from.

The section lies in the plane of the axes y and z of a beam, z = x × y with x the tangent. Shear
factors κ are those of Cowper 1966; torsion is that of Saint-Venant, for a rectangle by his series.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

# Terms of Saint-Venant's series: the first one left out is 1e-8 of the sum.
_SERIES_TERMS = 20


class BeamSection(NamedTuple):
    """Constants of a cross-section.

    Attributes:
        area: A [m²].
        inertia_y: I_y = ∫ z² dA, of bending that deflects along z [m⁴].
        inertia_z: I_z = ∫ y² dA, of bending that deflects along y [m⁴].
        torsion: J of Saint-Venant's torsion [m⁴].
        shear_area_y: κ_y A of shear along y [m²].
        shear_area_z: κ_z A of shear along z [m²].
        outline: Points on its outline by y and z, counter-clockwise about x [m], shape (count, 2).
    """

    area: float
    inertia_y: float
    inertia_z: float
    torsion: float
    shear_area_y: float
    shear_area_z: float
    outline: np.ndarray

    @property
    def radius(self) -> float:
        """Distance of the furthest point of the outline from the axis [m]."""
        return float(np.linalg.norm(self.outline, axis=1).max())

    def tapered(self, scales: np.ndarray) -> BeamSection:
        """The constants of elements with this stiffness, whose size changes linearly along them.

        They are exact for an even force, moment and shear.

        Args:
            scales: Size at both ends of each by that of this section, shape (element_count, 2).

        Returns:
            The section; its constants have the shape (element_count,).
        """
        a, b = scales.T
        plane, bending = a * b, 3.0 * (a * b) ** 3 / (a * a + a * b + b * b)
        return BeamSection(
            plane * self.area, bending * self.inertia_y, bending * self.inertia_z,
            bending * self.torsion, plane * self.shear_area_y, plane * self.shear_area_z,
            self.outline,
        )  # fmt: skip


def rectangle(thickness: float, width: float, poisson_ratio: float) -> BeamSection:
    """A rectangle.

    Args:
        thickness: Its extent along y [m].
        width: Its extent along z [m].
        poisson_ratio: ν, of the shear factor.
    """
    area = thickness * width
    shear = area * 10.0 * (1.0 + poisson_ratio) / (12.0 + 11.0 * poisson_ratio)
    y, z = 0.5 * thickness, 0.5 * width
    return BeamSection(
        area, thickness * width**3 / 12.0, width * thickness**3 / 12.0,
        _rectangle_torsion(thickness, width), shear, shear,
        np.array([[y, z], [-y, z], [-y, -z], [y, -z]]),
    )  # fmt: skip


def _rectangle_torsion(first: float, second: float) -> float:
    """J = a b³ (1/3 - 64/π⁵ b/a Σ tanh(n π a/2b)/n⁵) over odd n, with a ≥ b [m⁴]."""
    a, b = max(first, second), min(first, second)
    n = 1.0 + 2.0 * np.arange(_SERIES_TERMS)
    total = np.sum(np.tanh(0.5 * np.pi * n * a / b) / n**5)
    return float(a * b**3 * (1.0 / 3.0 - 64.0 / np.pi**5 * b / a * total))


def tube(outer_radius: float, inner_radius: float, poisson_ratio: float) -> BeamSection:
    """A circular tube; a full circle where the inner radius is zero.

    Args:
        outer_radius: [m].
        inner_radius: [m].
        poisson_ratio: ν, of the shear factor.
    """
    area = np.pi * (outer_radius**2 - inner_radius**2)
    bending = 0.25 * np.pi * (outer_radius**4 - inner_radius**4)
    nu, m = poisson_ratio, inner_radius / outer_radius
    square = (1.0 + m * m) ** 2
    factor = 6.0 * (1.0 + nu) * square / ((7.0 + 6.0 * nu) * square + (20.0 + 12.0 * nu) * m * m)
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    outline = outer_radius * np.column_stack([np.cos(angles), np.sin(angles)])
    return BeamSection(
        float(area), float(bending), float(bending), float(2.0 * bending), float(factor * area),
        float(factor * area), outline,
    )  # fmt: skip
