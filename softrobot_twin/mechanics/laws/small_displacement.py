"""Linear elasticity: small strain and no rotation, so that the stiffness is constant.

    Ψ = µ ε:ε + λ/2 tr²(ε),    P = 2µ ε + λ tr(ε) 1,    ε = sym(F - 1)

It is the cheapest law, and it is wrong where a body rotates: a rotation by θ gives the strain cos θ
- 1.

Arguments of the kernels here:
    strain: ε, three rows of three numbers.
Others are as in `neo_hookean`.
"""

from __future__ import annotations

from typing import NamedTuple

from softrobot_twin.geometry.matrix3 import (
    inner,
    plus_identity,
    scaled_matrix,
    symmetric,
    trace,
)
from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit
from softrobot_twin.mechanics.point_law import register_law


class SmallDisplacement(NamedTuple):
    """Parameters of the law.

    Attributes:
        lame_lambda: λ [Pa].
        shear_modulus: µ [Pa].
    """

    lame_lambda: float
    shear_modulus: float


@njit(**INLINED)
def hooke(law, strain):
    """2µ ε + λ tr(ε) 1 of a symmetric strain."""
    pressure = law.lame_lambda * trace(strain)
    return plus_identity(scaled_matrix(strain, 2.0 * law.shear_modulus), pressure)


@njit(**KERNEL, forceinline=True)
def energy_density(law, F):
    """Ψ [J/m³]."""
    strain = symmetric(plus_identity(F, -1.0))
    return 0.5 * inner(hooke(law, strain), strain)


@njit(**KERNEL, forceinline=True)
def stress(law, F):
    """P [Pa]."""
    return hooke(law, symmetric(plus_identity(F, -1.0)))


@njit(**KERNEL, forceinline=True)
def linearize(law, F, upright, projected):
    """The differential does not depend on F, and is never negative."""
    return F


@njit(**KERNEL, forceinline=True)
def differential(law, linearized, dF):
    """dP [Pa]."""
    return hooke(law, symmetric(dF))


register_law(
    "linear", SmallDisplacement, energy_density, stress, differential, linearize,
    projects=True, is_isotropic=True, is_linear=True,
)
