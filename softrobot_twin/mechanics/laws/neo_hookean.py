"""The Neo-Hookean law: rubber whose shear modulus does not depend on the strain.

    Ψ = µ/2 (Ī₁ - 3) + κ U(J),    U = (J² - 1 - 2 ln J)/4

`invariants.py` gives stress and differential. It fits most silicones up to about 50 % strain.

Arguments of the kernels here:
    F, dF: The deformation gradient and its change, three rows of three numbers.
    law: The parameters, the NamedTuple of the law.
    linearized: What `linearize` returned, rows of three numbers.
    projected: Whether the differential must be positive semidefinite.
    upright: Whether the point is neither flat nor inside out.
"""

from __future__ import annotations

from typing import NamedTuple

from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.invariants import (
    differential_of_first,
    first_invariant,
    linearize_first,
    stress_of_first,
)
from softrobot_twin.mechanics.material import bulk_modulus, shear_modulus
from softrobot_twin.mechanics.point_law import register_law
from softrobot_twin.mechanics.volume_change import volumetric


class NeoHookean(NamedTuple):
    """Parameters of the law.

    Attributes:
        shear_modulus: µ at rest [Pa].
        bulk_modulus: κ at rest [Pa]; zero where volume is another term's.
    """

    shear_modulus: float
    bulk_modulus: float


@njit(**KERNEL, forceinline=True)
def energy_density(law, F):
    """Ψ [J/m³]."""
    at = first_invariant(F)
    shape = 0.5 * law.shear_modulus * (at.power * at.square - 3.0)
    return shape + law.bulk_modulus * volumetric(at.volume)[0]


@njit(**KERNEL, forceinline=True)
def stress(law, F):
    """P [Pa]."""
    return stress_of_first(F, first_invariant(F), 0.5 * law.shear_modulus, law.bulk_modulus)


@njit(**KERNEL, forceinline=True)
def linearize(law, F, upright, projected):
    """F, its cofactors and five factors."""
    at = first_invariant(F)
    return linearize_first(F, at, 0.5 * law.shear_modulus, 0.0, law.bulk_modulus)


@njit(**KERNEL, forceinline=True)
def differential(law, linearized, dF):
    """dP [Pa]."""
    return differential_of_first(linearized, dF)


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
    "neo_hookean", NeoHookean, energy_density, stress, differential, linearize,
    is_isotropic=True,
    of_moduli=of_moduli,
)  # fmt: skip
