"""Colours of what is shown, the same in every viewer: tensions, pressures, bodies, points.

rerun is not needed here.
"""

from __future__ import annotations

import numpy as np

SURFACE_COLOUR = (178, 190, 208, 130)
"""Of deformable bodies, sRGB with alpha, 8 bits each."""
CLEAR_SURFACE_COLOUR = (178, 190, 208, 60)
"""The same of bodies in a scene with cavities, which are inside of them."""
RIGID_COLOUR = (214, 168, 96)
OBSTACLE_COLOUR = (112, 116, 124)
EFFECTOR_COLOUR = (255, 255, 255)
TARGET_COLOUR = (60, 220, 110)

_VACUUM, _NOTHING, _MIDDLE, _MOST = ([43, 98, 201], [150, 152, 158], [226, 176, 66], [214, 32, 32])
_NOT_FINITE_COLOUR = np.array([255, 0, 255, 255], dtype=np.uint8)
_SCALE_SIZE = 256


def _scale(stops: dict[float, list[int]]) -> np.ndarray:
    """Colours between those at places from 0 to 1, shape (_SCALE_SIZE, 4)."""
    place = np.linspace(0.0, 1.0, _SCALE_SIZE)
    colours = [np.interp(place, list(stops), part) for part in np.transpose(list(stops.values()))]
    return np.rint(np.column_stack([*colours, np.full(_SCALE_SIZE, 255.0)])).astype(np.uint8)


_TENSION_SCALE = _scale({0.0: _NOTHING, 0.5: _MIDDLE, 1.0: _MOST})
_PRESSURE_SCALE = _scale({0.0: _VACUUM, 0.5: _NOTHING, 0.75: _MIDDLE, 1.0: _MOST})


def tension_colours(tensions: np.ndarray, tension_range: tuple[float, float]) -> np.ndarray:
    """Colours of tensions: grey, amber, red.

    Args:
        tensions: Tensions [N], shape (cable_count,).
        tension_range: Tensions at the ends of the scale [N]; values outside get the end's colour.

    Returns:
        sRGB colours with alpha, shape (cable_count, 4), 8 bits each; a tension that is not
        finite is magenta.
    """
    slack, limit = tension_range
    return _colours((np.asarray(tensions, dtype=float) - slack) / (limit - slack), _TENSION_SCALE)


def pressure_colours(pressures: np.ndarray, pressure_range: tuple[float, float]) -> np.ndarray:
    """Colours of gauge pressures: grey at 0, amber to red above, blue in a vacuum.

    A pressure and a vacuum of the same magnitude have colours of the same strength.

    Args:
        pressures: Gauge pressures [Pa], shape (cavity_count,).
        pressure_range: Deepest vacuum or 0, and limit or 0 [Pa]; values outside get the end's
            colour.

    Returns:
        sRGB colours with alpha, shape (cavity_count, 4), 8 bits each; a pressure that is not
        finite is magenta.
    """
    vacuum, limit = pressure_range
    inside = np.clip(np.asarray(pressures, dtype=float), vacuum, limit)
    shares = 0.5 + 0.5 * inside / max(-vacuum, limit)
    return _colours(np.where(np.isfinite(pressures), shares, np.nan), _PRESSURE_SCALE)


def _colours(shares: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """Colours at shares of a scale, shape (count, 4); a share that is not finite is magenta."""
    known = np.isfinite(shares)
    places = np.clip(np.where(known, shares, 0.0), 0.0, 1.0)
    colours = scale[np.rint(places * (_SCALE_SIZE - 1)).astype(int)]
    colours[~known] = _NOT_FINITE_COLOUR
    return colours


def pressure_legend(pressure_range: tuple[float, float]) -> str:
    """The colour scale of pressures in words, such as ``blue -20, grey 0, red 20 kPa``.

    Args:
        pressure_range: Deepest vacuum and greatest pressure [Pa], gauge.
    """
    vacuum, limit = pressure_range
    end = 1e-3 * max(-vacuum, limit)
    words = ([f"blue {-end:g}"] if vacuum < 0.0 else []) + ["grey 0"]
    words += [f"red {end:g}"] if limit > 0.0 else []
    return f"{', '.join(words)} kPa"
