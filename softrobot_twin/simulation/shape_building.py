"""Shapes from their scene entries."""

from __future__ import annotations

from importlib import import_module

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.scene import Scene
from softrobot_twin.scene.body_entries import (
    BoxShape,
    CapsuleShape,
    CylinderShape,
    PlaneShape,
    SphereShape,
    SurfaceShape,
)

# A round shape is cut into facets this share of its radius long, where triangles are asked for.
FACETS = 0.4


def triangulated(shape) -> tuple[np.ndarray, np.ndarray]:
    """Surface of a shape: points in its frame [m], (n, 3), and triangles, (triangle_count, 3)."""
    return shape.surface(FACETS * getattr(shape, "radius", np.inf))


def build_shape(entry, scene: Scene, notes: list[str], shift=(0.0, 0.0, 0.0)):
    """Build a shape in the frame of its body or obstacle.

    Args:
        entry: What the scene says of it.
        scene: The scene.
        notes: Takes what was mended.
        shift: What to add to its coordinates [m], shape (3,).

    Returns:
        A shape of ``geometry.shapes``, or a `SolidSurface`.

    Raises:
        MeshError: A surface cannot be used.
    """
    shapes = import_module("softrobot_twin.geometry.shapes")
    shift = np.asarray(shift, float)
    if isinstance(entry, PlaneShape):
        normal = np.asarray(entry.normal) / np.linalg.norm(entry.normal)
        return shapes.Plane(shift + entry.point, normal)
    if isinstance(entry, SphereShape):
        return shapes.Sphere(shift + entry.centre, entry.radius)
    if isinstance(entry, CapsuleShape):
        return shapes.Capsule(shift + np.array(entry.ends), entry.radius)
    if isinstance(entry, CylinderShape):
        return shapes.Cylinder(shift + np.array(entry.ends), entry.radius)
    if isinstance(entry, BoxShape):
        rotation = Rotation.from_euler("xyz", entry.rotation).as_matrix()
        return shapes.Box(shift + entry.centre, np.array(entry.size), rotation)
    return _surface(entry, scene, notes, shift)


def _surface(entry: SurfaceShape, scene: Scene, notes: list[str], shift: np.ndarray):
    reading = import_module("softrobot_twin.geometry.surface_reading")
    return reading.read_solid_surface(
        scene.file_path(entry.file), scale=entry.scale, rotation=entry.rotation,
        translation=shift + entry.translation, notes=notes,
    )  # fmt: skip
