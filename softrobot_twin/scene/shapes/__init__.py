"""The rigid shapes of scenes: plane, sphere, capsule, cylinder and box, all convex, and files."""

from softrobot_twin.scene.shapes.box import Box
from softrobot_twin.scene.shapes.capsule import Capsule
from softrobot_twin.scene.shapes.cylinder import Cylinder
from softrobot_twin.scene.shapes.plane import Plane
from softrobot_twin.scene.shapes.shape_entry import AxialShape, Length, ShapeEntry
from softrobot_twin.scene.shapes.sphere import Sphere
from softrobot_twin.scene.shapes.surface_file import SurfaceFile

__all__ = [
    "AxialShape", "Box", "Capsule", "Cylinder", "Length", "Plane", "ShapeEntry", "Sphere", "SurfaceFile",
]  # fmt: skip
