"""Ogden's law: rubber in its principal stretches, by any number of terms.

    Ψ = Σ_p µ_p/α_p (g_p Σ_i λ_i^α_p - 3) + κ U(J),    g_p = J^(-α_p/3),    µ = ½ Σ_p µ_p α_p at rest

g_p makes the stretches independent of volume. Three terms fit rubber up to 700 % strain (Ogden
1972); α = 2 is the Neo-Hookean law, and α = 2 with α = -2 that of
Mooney and Rivlin. A term with α < 0 is the same in the areas A_k = λ_i λ_j, because the stretches without
their volume have the product one:

    g Σ_i λ_i^α = h Σ_k A_k^-α,    h = J^(2α/3)

So that all powers are of positive exponents, and energy grows where a material is pressed flat. With
Σ the sum of powers, Σ_i and Σ_ij its derivatives, g for g or h, and q = Σ_p µ_p/α_p g' Σ + κ U'

    ψ_i  = Σ_p µ_p/α_p g Σ_i + q J_i,    J_i = ∂J/∂λ_i
    a_ij = Σ_p µ_p/α_p g (Σ_i - Σ_j)/(λ_i - λ_j) - q λ_k
    b_ij = Σ_p µ_p/α_p g (Σ_i + Σ_j)/(λ_i + λ_j) + q λ_k

`principal_axes.py` makes the differential of them. Below `LEAST_STRETCH` powers are continued by their
Taylor polynomials, as those of J are in `volume_change.py`.

Arguments of the kernels here:
    a, l, x, y, z: Areas, stretches and powers of them, three numbers.
    alpha: α of a term.
    exponent: A positive power.
    first, second: Two stretches or areas.
    J: det F.
Others are as in `neo_hookean`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

from softrobot_twin.geometry.matrix3 import determinant, transposed_product
from softrobot_twin.geometry.vector3 import add_scaled, scaled
from softrobot_twin.kernels.compilation import INLINED, KERNEL, ONCE, njit
from softrobot_twin.mechanics.point_law import LawConstant, OwnConstants, register_law
from softrobot_twin.mechanics.principal_axes import (
    principal_axes,
    principal_differential,
    principal_rows,
)
from softrobot_twin.mechanics.volume_change import (
    continued,
    volume_power,
    volumetric,
    volumetric_slopes,
)

# Stretch, or area, below which powers are continued.
LEAST_STRETCH = 0.05


class Ogden(NamedTuple):
    """Parameters of the law.

    Attributes:
        shear_moduli: µ_p [Pa].
        exponents: α_p, as many; none is zero.
        bulk_modulus: κ at rest [Pa]; zero where volume is another term's.
    """

    shear_moduli: tuple[float, ...]
    exponents: tuple[float, ...]
    bulk_modulus: float


@njit(**INLINED)
def curvature_below(exponent):
    """Second derivative of a power below `LEAST_STRETCH`; where it is concave, none."""
    at_end = exponent * (exponent - 1.0) * math.exp((exponent - 2.0) * math.log(LEAST_STRETCH))
    return max(at_end, 0.0)


@njit(**INLINED)
def power(x, exponent):
    """A stretch or an area to a positive power, and its first two derivatives."""
    at = max(x, LEAST_STRETCH)
    value = math.exp(exponent * math.log(at))
    slope = exponent * value / at
    curvature = (exponent - 1.0) * slope / at if x >= at else curvature_below(exponent)
    return continued(value, slope, curvature, x - at)


@njit(**INLINED)
def divided_slope(first, second, exponent):
    """(f'(x) - f'(y))/(x - y) of a power f; f'' where both are equal."""
    high, low = max(first, second), min(first, second)
    upper, lower = max(high, LEAST_STRETCH), max(low, LEAST_STRETCH)
    # Of true powers: expm1 keeps all digits for numbers that are almost equal.
    part, less = upper - lower, exponent - 1.0
    ratio = part / lower
    share = less if ratio == 0.0 else math.expm1(less * math.log1p(ratio)) / ratio
    between = exponent * math.exp((less - 1.0) * math.log(lower)) * share
    if low >= LEAST_STRETCH:
        return between
    below = curvature_below(exponent)
    if high <= LEAST_STRETCH:
        return below
    return (between * part + below * (LEAST_STRETCH - low)) / (high - low)


@njit(**INLINED)
def areas(l):
    """A_k = λ_i λ_j = ∂J/∂λ_k."""
    return (l[1] * l[2], l[2] * l[0], l[0] * l[1])


@njit(**INLINED)
def powered(l, alpha):
    """What is raised to a power, the power, and the exponent of J: stretches, or areas."""
    if alpha > 0.0:
        return l, alpha, -alpha / 3.0
    return areas(l), -alpha, 2.0 * alpha / 3.0


@njit(**ONCE)
def energy_of_stretches(law, l, J):
    """Ψ of λ and J [J/m³]."""
    energy = law.bulk_modulus * volumetric(J)[0]
    for p in range(len(law.exponents)):
        alpha = law.exponents[p]
        x, exponent, of_volume = powered(l, alpha)
        total = power(x[0], exponent)[0] + power(x[1], exponent)[0] + power(x[2], exponent)[0]
        shape = volume_power(J, of_volume)[0] * total - 3.0
        energy += law.shear_moduli[p] / alpha * shape
    return energy


@njit(**KERNEL, forceinline=True)
def energy_density(law, F):
    """Ψ [J/m³]."""
    return energy_of_stretches(law, principal_axes(F)[1], determinant(F))


@njit(**INLINED)
def slopes(l, x, y, z, alpha):
    """Σ_i of the powers x, y, z of the three stretches or areas."""
    if alpha > 0.0:
        return (x[1], y[1], z[1])
    return (
        y[1] * l[2] + z[1] * l[1], z[1] * l[0] + x[1] * l[2], x[1] * l[1] + y[1] * l[0]
    )  # fmt: skip


@njit(**ONCE)
def stresses_of_stretches(law, l, J):
    """ψ_i of λ and J [Pa]."""
    q = law.bulk_modulus * volumetric_slopes(J)[0]
    total = (0.0, 0.0, 0.0)
    for p in range(len(law.exponents)):
        alpha = law.exponents[p]
        a, exponent, of_volume = powered(l, alpha)
        g, factor = volume_power(J, of_volume), law.shear_moduli[p] / alpha
        x, y, z = power(a[0], exponent), power(a[1], exponent), power(a[2], exponent)
        q += factor * g[1] * (x[0] + y[0] + z[0])
        total = add_scaled(total, slopes(l, x, y, z, alpha), factor * g[0])
    return add_scaled(total, areas(l), q)


@njit(**KERNEL, forceinline=True)
def stress(law, F):
    """P [Pa]."""
    U, stretches, V = principal_axes(F)
    s = stresses_of_stretches(law, stretches, determinant(F))
    return transposed_product(U, (scaled(V[0], s[0]), scaled(V[1], s[1]), scaled(V[2], s[2])))


@njit(**INLINED)
def curvatures(l, a, x, y, z, alpha, exponent):
    """Of the sum of powers: Σ_ii, Σ_ij of the pairs 23, 31, 12, and of these pairs
    (Σ_i - Σ_j)/(λ_i - λ_j) and (Σ_i + Σ_j)/(λ_i + λ_j).

    The last are without meaning where the sum of two stretches is almost zero, as it can be where
    the material is inside out.
    """
    between = (
        divided_slope(a[1], a[2], exponent), divided_slope(a[2], a[0], exponent),
        divided_slope(a[0], a[1], exponent),
    )  # fmt: skip
    sums = (
        (y[1] + z[1]) / max(l[1] + l[2], LEAST_STRETCH),
        (z[1] + x[1]) / max(l[2] + l[0], LEAST_STRETCH),
        (x[1] + y[1]) / max(l[0] + l[1], LEAST_STRETCH),
    )
    if alpha > 0.0:
        return (x[2], y[2], z[2]), (0.0, 0.0, 0.0), between, sums
    xx, yy, zz = l[0] * l[0], l[1] * l[1], l[2] * l[2]
    own = (y[2] * zz + z[2] * yy, z[2] * xx + x[2] * zz, x[2] * yy + y[2] * xx)
    pairs = (x[2] * a[0] + x[1], y[2] * a[1] + y[1], z[2] * a[2] + z[1])
    twists = (xx * between[0] - x[1], yy * between[1] - y[1], zz * between[2] - z[1])
    spins = (l[0] * sums[0] + x[1], l[1] * sums[1] + y[1], l[2] * sums[2] + z[1])
    return own, pairs, twists, spins


@njit(**ONCE)
def tangent_of_stretches(law, l, J):
    """ψ_ij, a_ij and b_ij of λ and J [Pa], as `principal_rows` takes them."""
    U, A, zero = volumetric_slopes(J), areas(l), (0.0, 0.0, 0.0)
    q, of_rate = law.bulk_modulus * U[0], law.bulk_modulus * U[1]
    own, pairs, twists, spins, mixed = zero, zero, zero, zero, zero
    for p in range(len(law.exponents)):
        alpha = law.exponents[p]
        a, exponent, of_volume = powered(l, alpha)
        g, factor = volume_power(J, of_volume), law.shear_moduli[p] / alpha
        x, y, z = power(a[0], exponent), power(a[1], exponent), power(a[2], exponent)
        total = factor * (x[0] + y[0] + z[0])
        q, of_rate = q + g[1] * total, of_rate + g[2] * total
        mixed = add_scaled(mixed, slopes(l, x, y, z, alpha), factor * g[1])
        parts = curvatures(l, a, x, y, z, alpha, exponent)
        own = add_scaled(own, parts[0], factor * g[0])
        pairs = add_scaled(pairs, parts[1], factor * g[0])
        twists = add_scaled(twists, parts[2], factor * g[0])
        spins = add_scaled(spins, parts[3], factor * g[0])
    diagonal = (
        own[0] + (2.0 * mixed[0] + of_rate * A[0]) * A[0],
        own[1] + (2.0 * mixed[1] + of_rate * A[1]) * A[1],
        own[2] + (2.0 * mixed[2] + of_rate * A[2]) * A[2],
        pairs[0] + A[1] * mixed[2] + A[2] * mixed[1] + of_rate * A[1] * A[2] + q * l[0],
        pairs[1] + A[2] * mixed[0] + A[0] * mixed[2] + of_rate * A[2] * A[0] + q * l[1],
        pairs[2] + A[0] * mixed[1] + A[1] * mixed[0] + of_rate * A[0] * A[1] + q * l[2],
    )
    return diagonal, add_scaled(twists, l, -q), add_scaled(spins, l, q)


@njit(**KERNEL, forceinline=True)
def linearize(law, F, upright, projected):
    """The axes of the stretches, and the differential in them."""
    U, stretches, V = principal_axes(F)
    diagonal, twists, spins = tangent_of_stretches(law, stretches, determinant(F))
    return principal_rows(U, V, diagonal, twists, spins, projected)


@njit(**KERNEL, forceinline=True)
def differential(law, linearized, dF):
    """dP [Pa]."""
    return principal_differential(linearized, dF)


def shear_modulus_of(constants: Mapping[str, tuple[float, ...]]) -> float:
    """µ at rest [Pa].

    Args:
        constants: ``shear_moduli`` [Pa] and ``exponents``, by name, as many of one as of the other.

    Raises:
        ValueError: There are not as many exponents as moduli, or one is zero.
    """
    moduli, exponents = constants["shear_moduli"], constants["exponents"]
    if len(moduli) != len(exponents):
        raise ValueError(f"has {len(moduli)} shear_moduli and {len(exponents)} exponents")
    if not all(exponents):
        raise ValueError("an exponent is 0, which makes no term")
    return 0.5 * sum(modulus * alpha for modulus, alpha in zip(moduli, exponents, strict=True))


def of_constants(constants: Mapping[str, tuple[float, ...]], bulk_modulus: float) -> Ogden:
    """Parameters of shear_moduli [Pa], exponents and κ [Pa].

    Args:
        constants: ``shear_moduli`` [Pa] and ``exponents``, by name, as many of one as of the other.
        bulk_modulus: κ [Pa].
    """
    moduli, exponents = constants["shear_moduli"], constants["exponents"]
    return Ogden(tuple(map(float, moduli)), tuple(map(float, exponents)), bulk_modulus)


register_law(
    "ogden", Ogden, energy_density, stress, differential, linearize, projects=True,
    is_isotropic=True,
    own=OwnConstants(
        (LawConstant("shear_moduli", "Pa", True), LawConstant("exponents", "", True)),
        shear_modulus_of, of_constants,
    ),
)  # fmt: skip
