"""The corotational law: small strain in the frame that turns with the material.

With F = R S and the left stretch V = F Rᵀ = R S Rᵀ

    Ψ    = µ ‖F - R‖² + λ/2 tr²(S - 1)  =  µ ‖V - 1‖² + λ/2 tr²(V - 1)
    P    = 2µ (F - R) + λ tr(S - 1) R,                    P Rᵀ  = 2µ (V - 1) + λ tr(V - 1) 1
    dP Rᵀ = 2µ A + λ tr(A) 1 - [c G⁻¹ w]×,    A = dF Rᵀ,  w = axial(A),
    c    = 2µ - λ tr(V - 1),    G = tr(V) 1 - V

w = axial(A) is the vector of the twice skew part, w₀ = A₂₁ - A₁₂ and so on: G⁻¹ w is the rate of R.
The differential is exact, so Newton's method converges quadratically. At rest the last term is
µ [w]×, and dP is that of linear elasticity.

Arguments of the kernels here:
    A: A matrix, three rows of three numbers.
    spin_stiffness: c G⁻¹ [Pa], what `linearize` returned, three rows of three numbers.
    V: The left stretch, three rows of three numbers.
Others are as in `neo_hookean`.
"""

from __future__ import annotations

from typing import NamedTuple

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    cofactor,
    cross_matrix,
    inner,
    plus_identity,
    scaled_matrix,
    trace,
    transform,
)
from softrobot_twin.geometry.vector3 import dot
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.laws.small_displacement import hooke
from softrobot_twin.mechanics.point_law import register_law


class Corotational(NamedTuple):
    """Parameters of the law.

    Attributes:
        lame_lambda: λ [Pa].
        shear_modulus: µ [Pa].
    """

    lame_lambda: float
    shear_modulus: float

    @property
    def bulk_modulus(self) -> float:
        """κ of small strains [Pa]."""
        return self.lame_lambda + 2.0 * self.shear_modulus / 3.0

    def with_bulk_modulus(self, bulk_modulus: float) -> Corotational:
        """The law of the same shear modulus and another κ [Pa]; see `patch_volumes.py`.

        Args:
            bulk_modulus: κ [Pa].
        """
        return self._replace(lame_lambda=bulk_modulus - 2.0 * self.shear_modulus / 3.0)


@njit(**KERNEL, forceinline=True)
def energy_density(law, V):
    """Ψ [J/m³]."""
    strain = plus_identity(V, -1.0)
    return 0.5 * inner(hooke(law, strain), strain)


@njit(**KERNEL, forceinline=True)
def stress(law, V):
    """P Rᵀ [Pa]."""
    return hooke(law, plus_identity(V, -1.0))


@njit(**KERNEL, forceinline=True)
def linearize(law, V, upright, projected):
    """The matrix c G⁻¹: change of the stress by the rotation [Pa].

    The differential is positive semidefinite if and only if c G⁻¹ ≤ µ 1. If it is not and
    `projected` is true, or if the material is flat, µ 1 is used instead.
    """
    mu = law.shear_modulus
    G = plus_identity(scaled_matrix(V, -1.0), trace(V))
    cofactors = cofactor(G)
    c = 2.0 * mu - law.lame_lambda * (trace(V) - 3.0)
    # Sylvester: is G - c/µ 1 positive definite?
    bound = plus_identity(G, -c / mu)
    minor = bound[0][0] * bound[1][1] - bound[0][1] * bound[0][1]
    third = dot(bound[0], cofactor(bound)[0])
    is_below = bound[0][0] > 0.0 and minor > 0.0 and third > 0.0
    is_exact = upright and (is_below or not projected)
    scale = c / dot(G[0], cofactors[0]) if is_exact else 0.0
    stand_in = 0.0 if is_exact else mu
    return plus_identity(scaled_matrix(cofactors, scale), stand_in)


@njit(**KERNEL, forceinline=True)
def differential(law, spin_stiffness, A):
    """dP Rᵀ [Pa] for A = dF Rᵀ."""
    axial = (A[2][1] - A[1][2], A[0][2] - A[2][0], A[1][0] - A[0][1])
    pressure = law.lame_lambda * trace(A)
    stretching = plus_identity(scaled_matrix(A, 2.0 * law.shear_modulus), pressure)
    return add_scaled_matrix(stretching, cross_matrix(transform(spin_stiffness, axial)), -1.0)


register_law(
    "corotational", Corotational, energy_density, stress, differential, linearize,
    projects=True, is_isotropic=True, turns=True,
)
