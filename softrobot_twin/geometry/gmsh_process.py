"""Runs gmsh in a process of its own; see `gmsh_mesher`, which runs there."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from softrobot_twin.errors import MeshError
from softrobot_twin.geometry import gmsh_mesher

INSTALL = "pip install gmsh"
"""Installs gmsh."""
LIBRARIES = ("libglu1-mesa libgl1 libgomp1 libxrender1 libxcursor1 libxfixes3 libxext6 libxft2 "
             "libxinerama1 libfontconfig1")  # fmt: skip
"""Ubuntu's packages of the libraries that gmsh loads, though it opens no window here."""


def run_gmsh(path: Path, job: dict, arrays: dict[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
    """Runs `gmsh_mesher` in a process of its own.

    Args:
        path: The file that is read, for errors.
        job: What to do; see `gmsh_mesher`.
        arrays: The shells of an STL file.

    Returns:
        The arrays that it wrote.

    Raises:
        MeshError: gmsh or a library of it is missing, or it cannot do it.
    """
    with tempfile.TemporaryDirectory(prefix="softrobot_twin_mesh_") as name:
        folder = Path(name)
        (folder / "job.json").write_text(json.dumps(job))
        if arrays is not None:
            np.savez(folder / "shells.npz", **arrays)
        # -P: the folder of the script has modules whose names are no business of gmsh.
        command = [sys.executable, "-P", gmsh_mesher.__file__, str(folder)]
        ended = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
        if (folder / "error.json").is_file():
            raise MeshError(path, _in_words(json.loads((folder / "error.json").read_text())))
        if ended.returncode or not (folder / "mesh.npz").is_file():
            last = " ".join(ended.stderr.split())[-300:] or "without a message"
            raise MeshError(path, f"gmsh ended with code {ended.returncode} ({last})")
        with np.load(folder / "mesh.npz") as made:
            return dict(made)


def _in_words(error: dict) -> str:
    """The error of `gmsh_mesher` as a sentence."""
    kind, text = error["kind"], " ".join(error["text"].split())
    if kind == "not installed":
        return (f"needs gmsh, which is not installed: {INSTALL} (there is no wheel for ARM: sudo "
                "apt install python3-gmsh)")
    if kind == "library":
        return f"needs gmsh, which cannot be loaded ({text}): sudo apt install {LIBRARIES}"
    return text if kind == "refused" else f"gmsh ended with an error ({text})"
