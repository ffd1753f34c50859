"""The law of Mooney and Rivlin: rubber that softens in tension, by two constants.

    Ψ  = c₁₀ (Ī₁ - 3) + c₀₁ (Ī₂ - 3) + κ U(J),    µ = 2 (c₁₀ + c₀₁) at rest
    P  = 2 c₁₀ m F + 2 c₀₁ n G + p C,    p = c₁₀ m' I₁ + c₀₁ n' I₂ + κ U'
    dP = 2 c₁₀ (m dF + m' J̇ F) + 2 c₀₁ (n dG + n' J̇ G) + p dC
         + (2 c₁₀ m' F : dF + 2 c₀₁ n' G : dF + p' J̇) C,    p' = c₁₀ m'' I₁ + c₀₁ n'' I₂ + κ U''

with the invariants and G of `invariants.py`. It fits rubber up to about 100 % strain (Rivlin
1948).

Arguments of the kernels here:
    F: A matrix, three rows of three numbers.
Others are as in `neo_hookean`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    cofactor,
    cofactor_change,
    determinant,
    inner,
    scaled_matrix,
)
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.point_law import LawConstant, OwnConstants, register_law
from softrobot_twin.mechanics.volume_change import volume_power, volumetric, volumetric_slopes


class MooneyRivlin(NamedTuple):
    """Parameters of the law.

    Attributes:
        c10: c₁₀ [Pa].
        c01: c₀₁ [Pa].
        bulk_modulus: κ at rest [Pa]; zero where volume is another term's.
    """

    c10: float
    c01: float
    bulk_modulus: float


@njit(**KERNEL, forceinline=True)
def energy_density(law, F):
    """Ψ [J/m³]."""
    J, C = determinant(F), cofactor(F)
    first = volume_power(J, -2.0 / 3.0)[0] * inner(F, F) - 3.0
    second = volume_power(J, -4.0 / 3.0)[0] * inner(C, C) - 3.0
    return law.c10 * first + law.c01 * second + law.bulk_modulus * volumetric(J)[0]


@njit(**KERNEL, forceinline=True)
def stress(law, F):
    """P [Pa]."""
    J, C = determinant(F), cofactor(F)
    m, n = volume_power(J, -2.0 / 3.0), volume_power(J, -4.0 / 3.0)
    p = law.c10 * m[1] * inner(F, F) + law.c01 * n[1] * inner(C, C)
    p += law.bulk_modulus * volumetric_slopes(J)[0]
    P = add_scaled_matrix(scaled_matrix(F, 2.0 * law.c10 * m[0]), C, p)
    return add_scaled_matrix(P, cofactor_change(F, C), 2.0 * law.c01 * n[0])


@njit(**KERNEL, forceinline=True)
def linearize(law, F, upright, projected):
    """F, C, G and the factors of dF, dC, dG, and of the pairs FC, GC, CC."""
    J, C = determinant(F), cofactor(F)
    G = cofactor_change(F, C)
    m, n, U = volume_power(J, -2.0 / 3.0), volume_power(J, -4.0 / 3.0), volumetric_slopes(J)
    first, second = law.c10 * inner(F, F), law.c01 * inner(C, C)
    p = first * m[1] + second * n[1] + law.bulk_modulus * U[0]
    CC = first * m[2] + second * n[2] + law.bulk_modulus * U[1]
    return (
        F[0], F[1], F[2], C[0], C[1], C[2], G[0], G[1], G[2],
        (2.0 * law.c10 * m[0], p, 2.0 * law.c01 * n[0]),
        (2.0 * law.c10 * m[1], 2.0 * law.c01 * n[1], CC),
    )  # fmt: skip


@njit(**KERNEL, forceinline=True)
def differential(law, linearized, dF):
    """dP [Pa]."""
    rows = linearized
    F, C, G = (rows[0], rows[1], rows[2]), (rows[3], rows[4], rows[5]), (rows[6], rows[7], rows[8])
    (s, p, r), (FC, GC, CC) = rows[9], rows[10]
    dC, rate = cofactor_change(F, dF), inner(C, dF)
    dG = add_scaled_matrix(cofactor_change(C, dF), cofactor_change(F, dC), 1.0)
    dP = add_scaled_matrix(scaled_matrix(dF, s), dC, p)
    dP = add_scaled_matrix(dP, dG, r)
    dP = add_scaled_matrix(dP, F, FC * rate)
    dP = add_scaled_matrix(dP, G, GC * rate)
    return add_scaled_matrix(dP, C, FC * inner(F, dF) + GC * inner(G, dF) + CC * rate)


def shear_modulus_of(constants: Mapping[str, float]) -> float:
    """µ at rest [Pa].

    Args:
        constants: c10 and c01 [Pa], by name.
    """
    return 2.0 * (constants["c10"] + constants["c01"])


def of_constants(constants: Mapping[str, float], bulk_modulus: float) -> MooneyRivlin:
    """Parameters of c10, c01 [Pa] and κ [Pa].

    Args:
        constants: c10 and c01 [Pa], by name.
        bulk_modulus: κ [Pa].
    """
    return MooneyRivlin(constants["c10"], constants["c01"], bulk_modulus)


register_law(
    "mooney_rivlin", MooneyRivlin, energy_density, stress, differential, linearize,
    is_isotropic=True,
    own=OwnConstants(
        (LawConstant("c10", "Pa"), LawConstant("c01", "Pa")), shear_modulus_of, of_constants
    ),
)  # fmt: skip
