"""Softening of rubber by its first stretch, the Mullins effect (Ogden and Roxburgh 1999).

The energy of the change of shape Ψ of a law is remembered where it was greatest, Ψ_m. Beyond it the
material is the law itself; below it the stress of the shape is multiplied by

    η = 1 - erf(x)/r,    x = (Ψ_m - Ψ)/D,    D = m + β Ψ_m

so that unloading and loading again follow one softer curve up to Ψ_m, and the curve of new material
beyond. There is no permanent set: η multiplies a stress that is zero at rest. The volume does not
soften. With G(x) = x erf(x) + exp(-x²)/√π,

    P  = η ∂Ψ/∂F + κ U' C
    dP = η (∂²Ψ/∂F² : dF) + η' (∂Ψ/∂F : dF) ∂Ψ/∂F + ...,   η' = 2 exp(-x²)/(√π r D)
    energy that unloading gives back:  Ψ - D/r (G(Ψ_m/D) - G(x))
    energy that the material has lost: D/r (G(Ψ_m/D) - G(0))

Ψ_m is that of the beginning of a step; a greater one in the step follows the law itself, which is
the same. It is remembered at the end of the step.

Arguments of the kernels here:
    constants: r, m and β of the law, m in Pa.
    energy, greatest: Ψ and Ψ_m [J/m³].
    F: The deformation gradient, three rows of three numbers.
    law: A `SoftenedLaw`, whose `greatest` has shape (batch_count, point_count, BATCH), or a
        `SoftenedPoint`.
    linearized: F, P and three factors, seven rows of three numbers.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    cofactor,
    cofactor_change,
    determinant,
    inner,
    scaled_matrix,
)
from softrobot_twin.kernels.compilation import GENERIC, njit
from softrobot_twin.mechanics.element_batches import at
from softrobot_twin.mechanics.point_law import (
    differential,
    energy_density,
    linearize,
    register_law,
    stress,
)
from softrobot_twin.mechanics.volume_change import volumetric

_ROOT_PI = math.sqrt(math.pi)


class SofteningConstants(NamedTuple):
    """Constants of the softening.

    Attributes:
        r: How little is lost at most: the stress falls by 1/r at most, above 1.
        m: Energy density m that sets how soon [J/m³], positive.
        beta: β, by how much later after greater stretches, not negative.
    """

    r: float
    m: float
    beta: float


class SoftenedLaw(NamedTuple):
    """A law whose points remember their greatest energy.

    Attributes:
        shape: Parameters of the law without its volume.
        bulk_modulus: κ [Pa].
        constants: Constants of the softening.
        greatest: Ψ_m at each point [J/m³], shape (batch_count, point_count, BATCH).
    """

    shape: tuple
    bulk_modulus: float
    constants: SofteningConstants
    greatest: np.ndarray


class SoftenedPoint(NamedTuple):
    """A `SoftenedLaw` at one point.

    Attributes:
        shape: Parameters of the law without its volume.
        bulk_modulus: κ [Pa].
        constants: Constants of the softening.
        greatest: Ψ_m [J/m³].
    """

    shape: tuple
    bulk_modulus: float
    constants: SofteningConstants
    greatest: float


@njit(**GENERIC)
def _softened_at(law, k, q, e):
    """The law at a point; see `register_law`."""
    return SoftenedPoint(law.shape, law.bulk_modulus, law.constants, law.greatest[k, q, at(0, e)])


@njit(**GENERIC)
def lag(constants, greatest, energy):
    """x and D; x is zero on the curve of new material."""
    span = constants.m + constants.beta * greatest
    return max(greatest - energy, 0.0) / span, span


@njit(**GENERIC)
def _primitive(x):
    """G(x), whose derivative is erf."""
    return x * math.erf(x) + math.exp(-x * x) / _ROOT_PI


@njit(**GENERIC)
def _softened_energy(law, F):
    """Energy that can be recovered [J/m³]."""
    energy, constants = energy_density(law.shape, F), law.constants
    x, span = lag(constants, law.greatest, energy)
    lost = span / constants.r * (_primitive(law.greatest / span) - _primitive(x))
    return energy - lost + law.bulk_modulus * volumetric(determinant(F))[0]


@njit(**GENERIC)
def softened_stress(law, F):
    """P [Pa]."""
    x, _ = lag(law.constants, law.greatest, energy_density(law.shape, F))
    share = 1.0 - math.erf(x) / law.constants.r
    pressure = law.bulk_modulus * volumetric(determinant(F))[1]
    of_shape = scaled_matrix(stress(law.shape, F), share)
    return add_scaled_matrix(of_shape, cofactor(F), pressure)


@njit(**GENERIC)
def _softened_linearize(law, F, upright, projected):
    """F, P of the shape, two factors, and what the differential of the law needs."""
    energy, constants = energy_density(law.shape, F), law.constants
    x, span = lag(constants, law.greatest, energy)
    share = 1.0 - math.erf(x) / constants.r
    # On the curve of new material nothing softens; at its very end the slope is that of loading.
    slope = 2.0 * math.exp(-x * x) / (_ROOT_PI * constants.r * span) if x > 0.0 else 0.0
    rows = (*F, *stress(law.shape, F), (share, slope, 0.0))
    return rows + linearize(law.shape, F, upright, False)


@njit(**GENERIC)
def _softened_differential(law, linearized, dF):
    """dP [Pa]."""
    F = (linearized[0], linearized[1], linearized[2])
    P = (linearized[3], linearized[4], linearized[5])
    share, slope, _ = linearized[6]
    dP = scaled_matrix(differential(law.shape, linearized[7:], dF), share)
    dP = add_scaled_matrix(dP, P, slope * inner(P, dF))
    C = cofactor(F)
    _, U_slope, U_curvature = volumetric(determinant(F))
    dP = add_scaled_matrix(dP, C, law.bulk_modulus * U_curvature * inner(C, dF))
    return add_scaled_matrix(dP, cofactor_change(F, dF), law.bulk_modulus * U_slope)


for _parameters, _at_point in ((SoftenedLaw, _softened_at), (SoftenedPoint, None)):
    register_law(
        f"softened ({_parameters.__name__})", _parameters, _softened_energy, softened_stress,
        _softened_differential, _softened_linearize, at_point=_at_point, is_law_of_scenes=False,
    )
