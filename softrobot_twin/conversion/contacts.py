"""Rules of contact: which surfaces may touch, at which distance, with which friction."""

from __future__ import annotations

from softrobot_twin.conversion.rules import CONTACTS, Conversion, rule
from softrobot_twin.conversion.scene_tree import NotConverted, SceneComponent

MODELS = ("TriangleCollisionModel", "LineCollisionModel", "PointCollisionModel", "SphereCollisionModel",
          "TriangleModel", "LineModel", "PointModel", "SphereModel", "Triangle", "Line", "Point", "Sphere",
          "TTriangleModel", "TLineModel", "TPointModel", "TriangleOctreeModel")  # fmt: skip
