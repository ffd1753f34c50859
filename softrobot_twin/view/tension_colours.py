"""Colours that say how taut a cable is: grey when slack, through amber, to red at its limit."""

from __future__ import annotations

import numpy as np

_STOPS = np.array([[150, 152, 158], [226, 176, 66], [214, 32, 32]]) / 255.0
_UNKNOWN = np.array([255, 0, 255, 255], dtype=np.uint8)
_STEP_COUNT = 256

# Oklab (B. Ottosson, "A perceptual color space for image processing", 2020): linear sRGB to the
# cones' responses, and their cube roots to lightness and two opponent colours.
_CONES = np.array([[0.4122214708, 0.5363325363, 0.0514459929],
                   [0.2119034982, 0.6806995451, 0.1073969566],
                   [0.0883024619, 0.2817188376, 0.6299787005]])
_OPPONENTS = np.array([[0.2104542553, 0.7936177850, -0.0040720468],
                       [1.9779984951, -2.4285922050, 0.4505937099],
                       [0.0259040371, 0.7827717662, -0.8086757660]])


def _to_oklab(srgb: np.ndarray) -> np.ndarray:
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return np.cbrt(linear @ _CONES.T) @ _OPPONENTS.T


def _from_oklab(lab: np.ndarray) -> np.ndarray:
    cones = np.linalg.solve(_OPPONENTS, lab.T) ** 3
    linear = np.clip(np.linalg.solve(_CONES, cones).T, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def _scale() -> np.ndarray:
    stops = _to_oklab(_STOPS)
    place = np.linspace(0.0, len(stops) - 1.0, _STEP_COUNT)
    lab = np.column_stack([np.interp(place, np.arange(len(stops)), axis) for axis in stops.T])
    opaque = np.full((_STEP_COUNT, 1), 255.0)
    return np.rint(np.hstack([255.0 * _from_oklab(lab), opaque])).astype(np.uint8)


_SCALE = _scale()


def tension_colours(tensions: np.ndarray, tension_range: tuple[float, float]) -> np.ndarray:
    """Colour each tension on a scale of even steps to the eye.

    Args:
        tensions: Tensions [N], shape (cable_count,).
        tension_range: Tensions of the scale's two ends [N]; beyond them the ends' colours hold.

    Returns:
        sRGB colours with alpha, shape (cable_count, 4), 8 bits each; a tension that is not
        finite is magenta.
    """
    tensions = np.asarray(tensions, dtype=float)
    slack, limit = tension_range
    known = np.isfinite(tensions)
    share = np.clip((np.where(known, tensions, slack) - slack) / (limit - slack), 0.0, 1.0)
    colours = _SCALE[np.rint(share * (_STEP_COUNT - 1)).astype(int)]
    colours[~known] = _UNKNOWN
    return colours
