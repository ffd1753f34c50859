"""Vectors, quaternions (x, y, z, w) and transforms as the helper package SPLIB offers scenes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation


class _Numbers(np.ndarray):
    """Some numbers; what changes them gives them back, as scenes chain calls."""

    usual: tuple[float, ...] = ()

    def __new__(cls, *given: Any) -> Any:
        values = given[0] if len(given) == 1 else given or cls.usual
        return np.resize(np.asarray(values, float), len(cls.usual)).view(cls)

    def _become(self, values: Any) -> Any:
        self[:] = values
        return self

    getNorm, toList = np.linalg.norm, np.ndarray.tolist
    normalize = lambda self: self._become(self / self.getNorm())  # noqa: E731


class Quat(_Numbers):
    """A quaternion."""

    usual = (0.0, 0.0, 0.0, 1.0)
    getRe, getIm = lambda self: float(self[3]), lambda self: np.array(self[:3])  # noqa: E731
    getMatrix = lambda self: Rotation.from_quat(self).as_matrix()  # noqa: E731
    getInverse = getConjugate = lambda self: Quat([*-self[:3], self[3]] / self.getNorm() ** 2)  # noqa: E731
    rotate = lambda self, vector: Rotation.from_quat(self).apply(vector)  # noqa: E731
    rotateFromQuat = lambda self, other: self._become(Quat.product(self, other))  # noqa: E731
    getEulerAngles = lambda self, axes="sxyz": Rotation.from_quat(self).as_euler(_axes(axes))  # noqa: E731

    @staticmethod
    def product(one: Any, other: Any) -> Quat:
        """The other turn, and then the one.

        Args:
            one: A quaternion.
            other: The one that turns first.
        """
        return Quat((Rotation.from_quat(one) * Rotation.from_quat(other)).as_quat())

    @staticmethod
    def createFromEuler(v: Any, axes: str = "sxyz", inDegree: bool = False) -> Quat:
        """A turn by three angles.

        Args:
            v: The angles.
            axes: Their axes; the first letter is r where these turn too.
            inDegree: Whether the angles are in degrees, not radians.
        """
        return Quat(Rotation.from_euler(_axes(axes), list(v), degrees=inDegree).as_quat())

    @staticmethod
    def createFromAxisAngle(axis: Any, angle: float) -> Quat:
        """A turn about an axis [rad].

        Args:
            axis: The axis.
            angle: The angle [rad].
        """
        return Quat([*(np.asarray(axis, float) * math.sin(0.5 * angle)), math.cos(0.5 * angle)]).normalize()


def _axes(axes: str) -> str:
    """Axes of angles as scipy names them: capitals where they turn too."""
    return axes[1:].upper() if axes[0] == "r" else axes[1:]


class Vec3(_Numbers):
    """A vector."""

    usual = (0.0, 0.0, 0.0)
    dot, cross = staticmethod(np.dot), staticmethod(lambda one, other: Vec3(np.cross(one, other)))
    translate = lambda self, *by: self._become(self + Vec3(*by))  # noqa: E731
    scale = lambda self, *by: self._become(self * Vec3(*by))  # noqa: E731
    rotateFromQuat = lambda self, quat: self._become(Rotation.from_quat(quat).apply(self))  # noqa: E731
    rotateFromEuler = lambda self, *given: self.rotateFromQuat(Quat.createFromEuler(*given))  # noqa: E731
    rotateFromAxisAngle = lambda self, *given: self.rotateFromQuat(Quat.createFromAxisAngle(*given))  # noqa: E731


def transform(translation: Any, rotation: Any = Quat.usual, scale: Any = None, eulerRotation: Any = None) -> Any:
    """The matrix of a scale, a turn (angles in degrees) and a translation, shape (4, 4).

    Args:
        translation: The translation.
        rotation: The turn, a quaternion.
        scale: Factor along each axis.
        eulerRotation: The turn as angles [degrees], in place of the quaternion.
    """
    turn = Quat(rotation) if eulerRotation is None else Quat.createFromEuler(eulerRotation, inDegree=True)
    made = np.eye(4)
    made[:3, :3] = turn.getMatrix() * (np.ones(3) if scale is None else np.asarray(scale, float))
    made[:3, 3] = translation
    return made


def transform_position(point: Any, matrixTRS: Any) -> np.ndarray:
    """A point by the matrix of `transform`.

    Args:
        point: The point.
        matrixTRS: The matrix.
    """
    return matrixTRS[:3, :3] @ np.asarray(point, float) + matrixTRS[:3, 3]


def transform_positions(position: Any, translation: Any = (0.0, 0.0, 0.0), *given: Any, **named: Any) -> list:
    """Points that are scaled, turned and moved; further arguments are a quaternion, angles and a scale.

    Args:
        position: The points.
        translation: The translation.
        *given: Further arguments of `transform`, in the order of the package.
        **named: These arguments by name.
    """
    named = dict(zip(("rotation", "eulerRotation", "scale"), given, strict=False)) | named
    return [transform_position(one, transform(translation, **named)).tolist() for one in position]


NUMERICS: dict[str, Any] = {
    **{key: value for key, value in vars(math).items() if not key.startswith("_")},
    "numpy": np, "Vec3": Vec3, "Quat": Quat,
    "to_radians": lambda v: [math.radians(one) for one in v] if isinstance(v, list) else math.radians(v),
    "TRS_to_matrix": transform, "transformPositions": transform_positions, "transformPosition": transform_position,
    **{key: lambda a, b, _by=by: _by(np.asarray(a, float), b).tolist() for key, by in
       {"vadd": np.add, "vsub": np.subtract, "sadd": np.add, "ssub": np.subtract, "smul": np.multiply}.items()},
}  # fmt: skip
"""Names of ``splib3.numerics``, which has those of `math` too."""
