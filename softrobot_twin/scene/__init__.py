"""Checked, frozen descriptions of the scenes that a user writes."""

from softrobot_twin.scene.loading import load_scene, scene_from_mapping
from softrobot_twin.scene.schema import Scene

__all__ = ["Scene", "load_scene", "scene_from_mapping"]
