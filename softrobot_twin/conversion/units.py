"""Units of SOFA scenes, which state none: they follow from gravity, or are given."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.study.first_scene import LARGEST_IN_METRES

SYSTEMS = {"mm-kg-s": (1e-3, 1.0), "mm-g-s": (1e-3, 1e-3), "cm-kg-s": (1e-2, 1.0), "m-kg-s": (1.0, 1.0)}
"""Metres and kilograms in the units of each system."""
_OF_GRAVITY = {9810.0: "mm-kg-s", 981.0: "cm-kg-s", 9.81: "m-kg-s"}
# As near as this, as a ratio, gravity is that of the earth; some files have 9180 for 9810.
_NEAR = 1.1


class Units(NamedTuple):
    """Units of a scene; the second is its unit of time.

    Attributes:
        name: Such as ``mm-kg-s``.
        metre: Metres in its unit of length.
        kilogram: Kilograms in its unit of mass.
        reason: Why these.
    """

    name: str
    metre: float
    kilogram: float
    reason: str

    force = property(lambda self: self.kilogram * self.metre)
    """Newtons in its unit of force."""
    pressure = property(lambda self: self.kilogram / self.metre)
    """Pascals in its unit of pressure."""
    torque = property(lambda self: self.kilogram * self.metre**2)
    """Newton metres in its unit of torque."""
    radian = property(lambda self: 1.0)
    """Radians in its unit of angle."""
    volume = property(lambda self: self.metre**3)
    """Cubic metres in its unit of volume."""
    density = property(lambda self: self.kilogram / self.metre**3)
    """kg/m³ in its unit of density."""
    stiffness = property(lambda self: self.kilogram)
    """N/m in its unit of stiffness."""


def units_of(gravity: np.ndarray, extent: float, given: str | None) -> Units:
    """The units of a scene.

    Args:
        gravity: Its gravity, shape (3,), or (0,) where the file gives none.
        extent: Largest extent of its bodies, in the unit of the file.
        given: Name of the system that the user gives; None to guess it.
    """
    if given is not None:
        return Units(given, *SYSTEMS[given], "as given")
    size = float(np.linalg.norm(gravity))
    for value, name in _OF_GRAVITY.items():
        if size and 1.0 / _NEAR < size / value < _NEAR:
            return Units(name, *SYSTEMS[name], f"gravity is {size:g}")
    reason = "the file sets no gravity" if not len(gravity) else f"gravity {size:g} tells nothing"
    name = "mm-kg-s" if extent > LARGEST_IN_METRES else "m-kg-s"
    return Units(name, *SYSTEMS[name], f"guessed: {reason}, the largest extent is {extent:.4g}; --units says it")
