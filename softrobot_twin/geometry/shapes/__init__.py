"""Analytic shapes: plane, sphere, capsule, cylinder and box, all convex."""

from softrobot_twin.geometry.shapes.box import Box
from softrobot_twin.geometry.shapes.capsule import Capsule
from softrobot_twin.geometry.shapes.cylinder import Cylinder
from softrobot_twin.geometry.shapes.plane import Plane
from softrobot_twin.geometry.shapes.shape import Shape
from softrobot_twin.geometry.shapes.sphere import Sphere

__all__ = ["Box", "Capsule", "Cylinder", "Plane", "Shape", "Sphere"]
