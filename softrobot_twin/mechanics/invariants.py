"""Stress and differential of energies that are functions of the invariants of F.

With J = det F, the cofactors C = J F⁻ᵀ, and F × C the change of cofactors (`cofactor_change`), which
is symmetric in all of its arguments,

    I₁ = F : F,    ∂I₁/∂F = 2 F
    I₂ = C : C,    ∂I₂/∂F = 2 G,    G = F × C
    ∂J/∂F = C,     dC = F × dF,     dG = dF × C + F × (F × dF)

Ī₁ = m I₁ with m = J^(-2/3) and Ī₂ = n I₂ with n = J^(-4/3) do not change with volume. `volume_change.py`
continues m, n and U below a small J, so that all of it is finite for flat and inverted points.

A kernel `linearize` stores what depends on F alone, and its `differential` takes it up:

    dP = s dF + p dC + (FF F : dF + FC J̇) F + (FC F : dF + CC J̇) C,    J̇ = C : dF

Arguments of the kernels here:
    dF: Change of F, three rows of three numbers.
    F: A matrix, three rows of three numbers.
    rows: Eight rows of three numbers.
"""

from __future__ import annotations

from typing import NamedTuple

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    cofactor,
    cofactor_change,
    determinant,
    inner,
    scaled_matrix,
)
from softrobot_twin.kernels.compilation import INLINED, njit
from softrobot_twin.mechanics.volume_change import volume_power, volumetric_slopes


class FirstInvariant(NamedTuple):
    """I₁ and m at one point.

    Attributes:
        volume: J.
        square: I₁.
        power: m.
        slope: dm/dJ.
        curvature: d²m/dJ².
    """

    volume: float
    square: float
    power: float
    slope: float
    curvature: float


@njit(**INLINED)
def first_invariant(F):
    """I₁ and m of F."""
    J = determinant(F)
    power, slope, curvature = volume_power(J, -2.0 / 3.0)
    return FirstInvariant(J, inner(F, F), power, slope, curvature)


@njit(**INLINED)
def stress_of_first(F, at, first, bulk_modulus):
    """P of Ψ = f(Ī₁) + κ U(J) [Pa].

    Args:
        F: The deformation gradient.
        at: Of `first_invariant`.
        first: f' [Pa].
        bulk_modulus: κ [Pa].
    """
    pressure = first * at.slope * at.square + bulk_modulus * volumetric_slopes(at.volume)[0]
    return add_scaled_matrix(scaled_matrix(F, 2.0 * first * at.power), cofactor(F), pressure)


@njit(**INLINED)
def linearize_first(F, at, first, second, bulk_modulus):
    """The rows of `differential_of_first`; see `stress_of_first`.

    Args:
        second: f'' [Pa].
    """
    C, U = cofactor(F), volumetric_slopes(at.volume)
    of_F, of_C = 2.0 * at.power, at.slope * at.square
    s, p = first * of_F, first * of_C + bulk_modulus * U[0]
    FF, FC = second * of_F * of_F, second * of_F * of_C + 2.0 * first * at.slope
    CC = second * of_C * of_C + first * at.curvature * at.square + bulk_modulus * U[1]
    return (F[0], F[1], F[2], C[0], C[1], C[2], (s, p, FF), (FC, CC, 0.0))


@njit(**INLINED)
def differential_of_first(rows, dF):
    """dP [Pa] of the rows of `linearize_first`."""
    F, C = (rows[0], rows[1], rows[2]), (rows[3], rows[4], rows[5])
    (s, p, FF), (FC, CC, _) = rows[6], rows[7]
    stretching, rate = inner(F, dF), inner(C, dF)
    dP = add_scaled_matrix(scaled_matrix(dF, s), cofactor_change(F, dF), p)
    dP = add_scaled_matrix(dP, F, FF * stretching + FC * rate)
    return add_scaled_matrix(dP, C, FC * stretching + CC * rate)
