"""Folders of the repository."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE, MESHES, CONFIG = ROOT / "softrobot_twin", ROOT / "meshes", ROOT / "config"
SCENES = CONFIG / "scenes"
