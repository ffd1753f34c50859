"""A copy of a scene file with some keys changed."""

from __future__ import annotations

import os
from pathlib import Path

import yaml

from softrobot_twin.scene import Scene, load_scene
from softrobot_twin.scene.body_entries import Mesh
from softrobot_twin.scene.entry import expanded
from softrobot_twin.scene.loading import read_yaml
from softrobot_twin.study.accuracy.choice import Setting
from softrobot_twin.study.reports.output_error import OutputError


def write_scene_copy(
    path: Path, original: Path, chosen: Scene, setting: Setting, remarks: list[str]
) -> None:
    """Writes a user's scene with the keys that a setting changes, and no other.

    Args:
        path: File to write.
        original: The user's scene file. Its comments are not kept.
        chosen: The scene on the chosen mesh.
        setting: What was chosen.
        remarks: Lines for the head of the file.

    Raises:
        OutputError: The file cannot be written.
    """
    content = expanded(Scene, read_yaml(original.read_text(encoding="utf-8")))
    body = content["body"]
    body["mesh"] = expanded(Mesh, body["mesh"])
    folder = path.resolve().parent
    file = os.path.relpath(chosen.mesh_path, folder)
    if chosen.body.fixed == load_scene(original).body.fixed:
        body["mesh"]["file"] = file
    else:  # a refined mesh: it stands in its place already and is held by its nodes
        body["mesh"] = {"file": file}
        body["fixed"] = [{"nodes": list(region.nodes)} for region in chosen.body.fixed]
    body["element"] = setting.element
    body["material"]["law"] = setting.law
    for entry, cable in zip(content["cables"], chosen.cables, strict=True):
        entry["hold_radius"] = cable.hold_radius
    content["solver"] = {**(content.get("solver") or {}), "newton_iterations": setting.iterations}
    head = "".join(f"# {line}\n" for line in remarks)
    text = yaml.safe_dump(content, sort_keys=False, allow_unicode=True, default_flow_style=None)
    try:
        path.write_text(head + text, encoding="utf-8")
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error
