"""Yeoh's law: rubber that stiffens at large strain, by three constants.

    Ψ = c₁ (Ī₁ - 3) + c₂ (Ī₁ - 3)² + c₃ (Ī₁ - 3)³ + κ U(J),    µ = 2 c₁ at rest

`invariants.py` gives stress and differential. It is fitted to a tensile curve alone with less risk than
the law of Mooney and Rivlin, because Ī₁ says nothing of the kind of deformation (Yeoh
1993).

Arguments of the kernels here:
    at: What `first_invariant` returned.
Others are as in `neo_hookean`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit
from softrobot_twin.mechanics.invariants import (
    differential_of_first,
    first_invariant,
    linearize_first,
    stress_of_first,
)
from softrobot_twin.mechanics.point_law import LawConstant, OwnConstants, register_law
from softrobot_twin.mechanics.volume_change import volumetric


class Yeoh(NamedTuple):
    """Parameters of the law.

    Attributes:
        c1: c₁ [Pa].
        c2: c₂ [Pa].
        c3: c₃ [Pa].
        bulk_modulus: κ at rest [Pa]; zero where volume is another term's.
    """

    c1: float
    c2: float
    c3: float
    bulk_modulus: float


@njit(**INLINED)
def slopes(law, at):
    """The first and the second derivative of Ψ by Ī₁."""
    beyond = at.power * at.square - 3.0
    first = law.c1 + (2.0 * law.c2 + 3.0 * law.c3 * beyond) * beyond
    return first, 2.0 * law.c2 + 6.0 * law.c3 * beyond


@njit(**KERNEL, forceinline=True)
def energy_density(law, F):
    """Ψ [J/m³]."""
    at = first_invariant(F)
    beyond = at.power * at.square - 3.0
    shape = (law.c1 + (law.c2 + law.c3 * beyond) * beyond) * beyond
    return shape + law.bulk_modulus * volumetric(at.volume)[0]


@njit(**KERNEL, forceinline=True)
def stress(law, F):
    """P [Pa]."""
    at = first_invariant(F)
    return stress_of_first(F, at, slopes(law, at)[0], law.bulk_modulus)


@njit(**KERNEL, forceinline=True)
def linearize(law, F, upright, projected):
    """F, its cofactors and five factors."""
    at = first_invariant(F)
    first, second = slopes(law, at)
    return linearize_first(F, at, first, second, law.bulk_modulus)


@njit(**KERNEL, forceinline=True)
def differential(law, linearized, dF):
    """dP [Pa]."""
    return differential_of_first(linearized, dF)


def shear_modulus_of(constants: Mapping[str, float]) -> float:
    """µ at rest [Pa].

    Args:
        constants: c1, c2 and c3 [Pa], by name.
    """
    return 2.0 * constants["c1"]


def of_constants(constants: Mapping[str, float], bulk_modulus: float) -> Yeoh:
    """Parameters of c1, c2, c3 [Pa] and κ [Pa].

    Args:
        constants: c1, c2 and c3 [Pa], by name.
        bulk_modulus: κ [Pa].
    """
    return Yeoh(constants["c1"], constants["c2"], constants["c3"], bulk_modulus)


register_law(
    "yeoh", Yeoh, energy_density, stress, differential, linearize,
    is_isotropic=True,
    own=OwnConstants(
        tuple(LawConstant(name, "Pa") for name in ("c1", "c2", "c3")), shear_modulus_of, of_constants
    ),
)  # fmt: skip
