"""Elastic constants."""

from __future__ import annotations

from typing import NamedTuple


INCOMPRESSIBLE = 1.0e4
"""Bulk modulus of a Poisson's ratio of exactly 0.5, by the shear modulus: where the pressure is p, the
volume changes by the share p/κ."""


class LameParameters(NamedTuple):
    """Lamé's constants of an isotropic material.

    Attributes:
        lame_lambda: First parameter λ [Pa].
        shear_modulus: Second parameter µ [Pa].
    """

    lame_lambda: float
    shear_modulus: float


def lame_parameters(young_modulus: float, poisson_ratio: float) -> LameParameters:
    """Turn E and ν into λ and µ.

    Args:
        young_modulus: E [Pa], positive.
        poisson_ratio: ν, above -1 and below 0.5.

    Returns:
        Lamé's constants [Pa].

    Raises:
        ValueError: No such material exists.
    """
    if not young_modulus > 0.0:
        raise ValueError(f"young_modulus must be positive, not {young_modulus} Pa")
    if not -1.0 < poisson_ratio < 0.5:
        raise ValueError(f"poisson_ratio must lie between -1 and 0.5, not {poisson_ratio}")
    lame_lambda = young_modulus * poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))
    return LameParameters(lame_lambda, shear_modulus(young_modulus, poisson_ratio))


def shear_modulus(young_modulus: float, poisson_ratio: float) -> float:
    """µ of E and ν [Pa].

    Args:
        young_modulus: E [Pa].
        poisson_ratio: ν.
    """
    return young_modulus / (2.0 * (1.0 + poisson_ratio))


def bulk_modulus(young_modulus: float, poisson_ratio: float) -> float:
    """κ of E and ν [Pa].

    Args:
        young_modulus: E [Pa].
        poisson_ratio: ν, at most 0.5; for 0.5 itself κ is `INCOMPRESSIBLE` shear moduli.
    """
    if poisson_ratio == 0.5:
        return INCOMPRESSIBLE * shear_modulus(young_modulus, poisson_ratio)
    return young_modulus / (3.0 * (1.0 - 2.0 * poisson_ratio))


def moduli_of_shear_and_bulk(shear_modulus: float, bulk_modulus: float) -> tuple[float, float]:
    """E [Pa] and ν of µ and κ.

    Args:
        shear_modulus: µ [Pa], positive.
        bulk_modulus: κ [Pa], positive.
    """
    whole = 3.0 * bulk_modulus + shear_modulus
    return (9.0 * bulk_modulus * shear_modulus / whole,
            0.5 * (3.0 * bulk_modulus - 2.0 * shear_modulus) / whole)


def bulk_modulus_of_shear(shear_modulus: float, poisson_ratio: float) -> float:
    """κ of µ and ν [Pa].

    Args:
        shear_modulus: µ [Pa].
        poisson_ratio: ν, at most 0.5; for 0.5 itself κ is `INCOMPRESSIBLE` shear moduli.
    """
    if poisson_ratio == 0.5:
        return INCOMPRESSIBLE * shear_modulus
    return 2.0 * shear_modulus * (1.0 + poisson_ratio) / (3.0 * (1.0 - 2.0 * poisson_ratio))


def poisson_ratio_of_bulk(young_modulus: float, bulk_modulus: float) -> float:
    """ν of E and κ.

    Args:
        young_modulus: E [Pa].
        bulk_modulus: κ [Pa].
    """
    return 0.5 - young_modulus / (6.0 * bulk_modulus)
