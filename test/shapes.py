"""Shapes of scenes, made of arrays."""

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.scene import shapes


def _places(values):
    return np.asarray(values, float).tolist()


def Sphere(centre, radius):
    return shapes.Sphere(centre=_places(centre), radius=radius)


def Capsule(ends, radius):
    return shapes.Capsule(ends=_places(ends), radius=radius)


def Cylinder(ends, radius):
    return shapes.Cylinder(ends=_places(ends), radius=radius)


def Plane(point, normal):
    return shapes.Plane(point=_places(point), normal=_places(normal))


def Box(centre, size, rotation=None):
    """With the directions of its sides as columns of a rotation, shape (3, 3)."""
    turn = Rotation.identity() if rotation is None else Rotation.from_matrix(rotation)
    return shapes.Box(
        centre=_places(centre), size=_places(size), rotation=_places(turn.as_euler("xyz"))
    )
