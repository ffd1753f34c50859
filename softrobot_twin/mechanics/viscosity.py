"""Viscoelasticity at finite strain by a Prony series (Simo 1987; Holzapfel 2000, section 6.10).

Beside the law, which is what remains after a long time, act overstresses Q_i that relax:

    S = S_law + Σ Q_i,    Q_i' + Q_i/τ_i = γ_i S_shape',    γ_i = g_i/(1 - Σ g_j)

with second Piola-Kirchhoff stresses. S_shape is the law's stress of the change of shape: the volume
does not relax. The g_i are shares of the modulus at once, as in published series:
E(t) = E_0 (1 - Σ g_i (1 - exp(-t/τ_i))); the law has the modulus after a long time,
E_0 (1 - Σ g_i).

Where S_shape changes evenly within a step of duration h, from S₀ to S, the equation has the
solution

    Q_i = e_i Q_i0 + f_i γ_i (S - S₀),    e_i = exp(-h/τ_i),    f_i = (1 - e_i) τ_i/h

so that long steps give what is relaxed, and the viscosity of slow motion. In a step it is the
derivative of a potential, with H known from its beginning,

    (1 + β) Ψ_shape(F) + κ U(J) + (C - 1) : H/2,    β = Σ f_i γ_i,    H = Σ (e_i Q_i0 - f_i γ_i S₀)
    P  = (1 + β) P_shape + κ U' cof F + F H
    dP = (1 + β) dP_shape + ... + dF H

A law of the bulk modulus κ/(1 + β), times 1 + β, is the first two terms. Stresses on the material
turn with it: a rotation changes nothing, however long it takes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.matrix3 import (
    add_scaled_matrix,
    cofactor,
    determinant,
    inner,
    plus_identity,
    product,
    scaled_matrix,
    symmetric,
    transposed_product,
)
from softrobot_twin.kernels.compilation import GENERIC, njit
from softrobot_twin.mechanics.element_batches import matrix_at
from softrobot_twin.mechanics.point_law import (
    differential,
    energy_density,
    law_at,
    linearize,
    register_law,
    stress,
)
from softrobot_twin.mechanics.volume_change import LEAST_VOLUME


class ViscousTerm(NamedTuple):
    """A term of a Prony series.

    Attributes:
        share: g, share of the modulus at once that relaxes.
        time: τ, in which it relaxes to 1/e [s].
    """

    share: float
    time: float


class ViscousLaw(NamedTuple):
    """A law with overstresses that points remember.

    Attributes:
        base: Parameters of the law, with κ/(1 + β).
        scale: 1 + β.
        memory: H at each point [Pa], shape (batch_count, point_count, 9 × BATCH).
    """

    base: tuple
    scale: float
    memory: np.ndarray


class ViscousPoint(NamedTuple):
    """A `ViscousLaw` at one point.

    Attributes:
        base: Parameters of the law at this point, with κ/(1 + β).
        scale: 1 + β.
        memory: H [Pa], a symmetric matrix.
    """

    base: tuple
    scale: float
    memory: tuple


@njit(**GENERIC)
def _viscous_at(law, k, q, e):
    """The law at a point; see `register_law`."""
    base = law_at(law.base, k, q, e)
    return ViscousPoint(base, law.scale, matrix_at(law.memory[k, q], 0, e))


@njit(**GENERIC)
def _viscous_energy(law, F):
    """The potential of the step [J/m³]."""
    strain = plus_identity(transposed_product(F, F), -1.0)
    return law.scale * energy_density(law.base, F) + 0.5 * inner(strain, law.memory)


@njit(**GENERIC)
def _viscous_stress(law, F):
    """P [Pa]."""
    return add_scaled_matrix(product(F, law.memory), stress(law.base, F), law.scale)


@njit(**GENERIC)
def _viscous_linearize(law, F, upright, projected):
    """What the differential of the law needs."""
    return linearize(law.base, F, upright, False)


@njit(**GENERIC)
def _viscous_differential(law, linearized, dF):
    """dP [Pa]."""
    dP = differential(law.base, linearized, dF)
    return add_scaled_matrix(product(dF, law.memory), dP, law.scale)


@njit(**GENERIC)
def second_piola(law, F):
    """S = F⁻¹ P of a law; finite where a point is flat or inside out."""
    C = cofactor(F)
    inverse = 1.0 / max(determinant(F), LEAST_VOLUME)
    return symmetric(scaled_matrix(transposed_product(C, stress(law, F)), inverse))


def instant_shares(series: tuple[ViscousTerm, ...]) -> np.ndarray:
    """γ_i: overstresses over the stress of the law, shape (term_count,).

    Args:
        series: The terms.
    """
    shares = np.array([term.share for term in series])
    return shares / (1.0 - shares.sum())


class StepFactors(NamedTuple):
    """Factors of a step of one duration.

    Attributes:
        kept: e_i, shape (term_count,).
        gained: f_i γ_i, shape (term_count,).
    """

    kept: np.ndarray
    gained: np.ndarray

    @property
    def scale(self) -> float:
        """1 + β."""
        return 1.0 + float(self.gained.sum())


def step_factors(series: tuple[ViscousTerm, ...], time_step: float) -> StepFactors:
    """The factors of a step.

    Args:
        series: The terms.
        time_step: h [s]; 0 for a step in which no time passes, infinite for one that relaxes all.
    """
    ratios = time_step / np.array([term.time for term in series])
    even = np.divide(-np.expm1(-ratios), ratios, out=np.ones(len(ratios)), where=ratios > 0.0)
    return StepFactors(np.exp(-ratios), even * instant_shares(series))


for _parameters, _at_point in ((ViscousLaw, _viscous_at), (ViscousPoint, None)):
    register_law(
        f"viscous ({_parameters.__name__})", _parameters, _viscous_energy, _viscous_stress,
        _viscous_differential, _viscous_linearize, at_point=_at_point, is_law_of_scenes=False,
    )
