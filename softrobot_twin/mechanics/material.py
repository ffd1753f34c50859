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
    lame_lambda = young_modulus * poisson_ratio / (
        (1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio)
    )
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
