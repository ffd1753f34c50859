"""The meshes that are kept, and the scripts that make them."""

import importlib.util
import sys
from functools import cache
from pathlib import Path

import pytest

from softrobot_twin.geometry.mesh_reading import read_solid_mesh

MESHES = Path(__file__).resolve().parents[2] / "meshes"
# What the scripts share is no part of the package.
sys.path.append(str(MESHES.parent))


@pytest.fixture(scope="session")
def kept_mesh():
    """Reads a mesh by its name; there is nothing to note about one that is kept."""

    @cache
    def read(name):
        reading = read_solid_mesh(MESHES / f"{name}.vtk")
        # The fingers of a hand are separate parts.
        assert all("separate parts" in note and "hand" in name for note in reading.notes)
        return reading.mesh

    return read


@pytest.fixture(scope="session")
def mesh_script():
    """Loads a script that makes meshes, by its name."""
    names = []

    @cache
    def load(name):
        spec = importlib.util.spec_from_file_location(name, MESHES / f"{name}.py")
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        names.append(name)
        spec.loader.exec_module(module)
        return module

    yield load
    for name in names:
        del sys.modules[name]
