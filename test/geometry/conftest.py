"""The meshes that are kept."""

import sys
from functools import cache

import pytest

from softrobot_twin.geometry.mesh_reading import read_solid_mesh
from test.places import MESHES

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
