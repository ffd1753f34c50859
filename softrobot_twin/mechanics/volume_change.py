"""Functions of the volume ratio J = det F that hyperelastic laws are made of.

They grow without bound as J approaches zero. Below `LEAST_VOLUME` each is continued by its quadratic
Taylor polynomial there, so that value, slope and curvature are continuous and finite at every J: a
point that is flat or inside out is pushed back by finite forces.

Arguments of the kernels here:
    exponent: The power.
    J: The volume ratio.
"""

from __future__ import annotations

import math

from softrobot_twin.kernels.compilation import INLINED, KERNEL, njit

# Volume ratio below which functions are continued: far below what a converged step keeps.
LEAST_VOLUME = 0.05


@njit(**INLINED)
def continued(value, slope, curvature, beyond):
    """A function and two derivatives, continued from where they were taken.

    Args:
        value, slope, curvature: Where they were taken.
        beyond: Distance from there, zero where the function is not continued.
    """
    end_slope = slope + curvature * beyond
    return value + 0.5 * (slope + end_slope) * beyond, end_slope, curvature


@njit(**KERNEL, forceinline=True)
def volumetric(J):
    """U = (J² - 1 - 2 ln J)/4 and its first two derivatives, U'' = 1 at rest."""
    at = max(J, LEAST_VOLUME)
    value = 0.25 * (at * at - 1.0) - 0.5 * math.log(at)
    return continued(value, 0.5 * (at - 1.0 / at), 0.5 * (1.0 + 1.0 / (at * at)), J - at)


@njit(**INLINED)
def volumetric_slopes(J):
    """U' and U'', without the logarithm that U itself needs."""
    at = max(J, LEAST_VOLUME)
    curvature = 0.5 * (1.0 + 1.0 / (at * at))
    return 0.5 * (at - 1.0 / at) + curvature * (J - at), curvature


@njit(**INLINED)
def volume_power(J, exponent):
    """J to a power, and its first two derivatives."""
    at = max(J, LEAST_VOLUME)
    value = math.exp(exponent * math.log(at))
    slope = exponent * value / at
    return continued(value, slope, (exponent - 1.0) * slope / at, J - at)
