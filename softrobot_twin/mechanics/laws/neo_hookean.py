"""The Neo-Hookean law: rubber whose shear modulus does not depend on the strain.

With J = det F, I₁ = F : F, the cofactors C = J F⁻ᵀ and m = J^(-2/3)

    Ψ  = µ/2 (m I₁ - 3) + κ U(J),    U = (J² - 1 - 2 ln J)/4
    P  = µ m F + p C,                p = µ/2 m' I₁ + κ U'
    dP = µ m dF + µ m' J̇ F + (µ m' F : dF + (µ/2 m'' I₁ + κ U'') J̇) C + p dC,    J̇ = C : dF

`volume_change.py` continues m and U below a small J, so that all of it is finite for flat and
inverted points.
"""

from __future__ import annotations

from typing import NamedTuple

from numba import njit

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    cofactor,
    cofactor_change,
    determinant,
    inner,
    scaled_matrix,
)
from softrobot_twin.geometry.vector3 import INLINED
from softrobot_twin.mechanics.material import bulk_modulus, shear_modulus
from softrobot_twin.mechanics.point_law import register_law
from softrobot_twin.mechanics.volume_change import volume_power, volumetric


class NeoHookean(NamedTuple):
    """Parameters of the law.

    Attributes:
        shear_modulus: µ at rest [Pa].
        bulk_modulus: κ at rest [Pa]; zero where volume is another term's.
    """

    shear_modulus: float
    bulk_modulus: float


@njit(**INLINED)
def energy_density(law, F):
    """Ψ [J/m³]."""
    J = determinant(F)
    shape = volume_power(J, -2.0 / 3.0)[0] * inner(F, F) - 3.0
    return 0.5 * law.shear_modulus * shape + law.bulk_modulus * volumetric(J)[0]


@njit(**INLINED)
def stress(law, F):
    """P [Pa]."""
    J, mu = determinant(F), law.shear_modulus
    m, slope, _ = volume_power(J, -2.0 / 3.0)
    pressure = 0.5 * mu * slope * inner(F, F) + law.bulk_modulus * volumetric(J)[1]
    return add_scaled_matrix(scaled_matrix(F, mu * m), cofactor(F), pressure)


@njit(**INLINED)
def differential(law, F, dF):
    """dP [Pa]."""
    J, mu, kappa, C = determinant(F), law.shear_modulus, law.bulk_modulus, cofactor(F)
    m, slope, curvature = volume_power(J, -2.0 / 3.0)
    _, U_slope, U_curvature = volumetric(J)
    half_square, rate = 0.5 * mu * inner(F, F), inner(C, dF)
    of_C = mu * slope * inner(F, dF) + (half_square * curvature + kappa * U_curvature) * rate
    dP = add_scaled_matrix(scaled_matrix(dF, mu * m), F, mu * slope * rate)
    dP = add_scaled_matrix(dP, C, of_C)
    return add_scaled_matrix(dP, cofactor_change(F, dF), half_square * slope + kappa * U_slope)


def of_moduli(young_modulus: float, poisson_ratio: float) -> NeoHookean:
    """Parameters of a material with these constants at rest.

    Args:
        young_modulus: E [Pa].
        poisson_ratio: ν.
    """
    return NeoHookean(
        shear_modulus(young_modulus, poisson_ratio), bulk_modulus(young_modulus, poisson_ratio)
    )


register_law(
    "neo_hookean", NeoHookean, energy_density, stress, differential, of_moduli=of_moduli
)
