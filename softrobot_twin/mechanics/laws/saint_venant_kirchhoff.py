"""The law of St. Venant and Kirchhoff: Hooke's law between Green's strain and its stress.

    Ψ  = µ E : E + λ/2 tr²(E),    E = (FᵀF - 1)/2
    P  = F S,    S = 2µ E + λ tr(E) 1
    dP = dF S + F dS,    dS = 2µ dE + λ tr(dE) 1,    dE = sym(FᵀdF)

It is for large rotations with small strains. Under compression it is soft: a bar pressed to 58 % of
its length bears the greatest load of all, and a point turned inside out is at rest again. It does
not push back from a flat shape by itself; `volume_barrier.py` does.

Arguments of the kernels here:
    F: A matrix, three rows of three numbers.
    linearized: F and S, six rows of three numbers.
Others are as in `neo_hookean`.
"""

from __future__ import annotations

from typing import NamedTuple

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    inner,
    plus_identity,
    product,
    scaled_matrix,
    symmetric,
    transposed_product,
)
from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit
from softrobot_twin.mechanics.laws.small_displacement import hooke
from softrobot_twin.mechanics.point_law import register_law, second_stress


class SaintVenantKirchhoff(NamedTuple):
    """Parameters of the law.

    Attributes:
        lame_lambda: λ [Pa].
        shear_modulus: µ [Pa].
    """

    lame_lambda: float
    shear_modulus: float


@njit(**INLINED)
def green_strain(F):
    """E = (FᵀF - 1)/2."""
    return scaled_matrix(plus_identity(transposed_product(F, F), -1.0), 0.5)


@njit(**KERNEL, forceinline=True)
def energy_density(law, F):
    """Ψ [J/m³]."""
    strain = green_strain(F)
    return 0.5 * inner(second_stress(law, strain), strain)


@njit(**KERNEL, forceinline=True)
def stress(law, F):
    """P [Pa]."""
    return product(F, second_stress(law, green_strain(F)))


@njit(**KERNEL, forceinline=True)
def linearize(law, F, upright, projected):
    """F and S."""
    S = second_stress(law, green_strain(F))
    return (F[0], F[1], F[2], S[0], S[1], S[2])


@njit(**KERNEL, forceinline=True)
def differential(law, linearized, dF):
    """dP [Pa]."""
    F = (linearized[0], linearized[1], linearized[2])
    S = (linearized[3], linearized[4], linearized[5])
    dS = second_stress(law, symmetric(transposed_product(F, dF)))
    return add_scaled_matrix(product(dF, S), product(F, dS), 1.0)


register_law(
    "saint_venant_kirchhoff", SaintVenantKirchhoff, energy_density, stress, differential, linearize,
    is_isotropic=True, second_stress=hooke,
)  # fmt: skip
