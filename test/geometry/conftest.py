"""Small bodies that the tests of this room share."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from softrobot_twin.geometry.tet_mesh import TetMesh


@pytest.fixture
def block() -> Callable[..., TetMesh]:
    """Makes a box of cells, six tetrahedra each, with its inner nodes moved about."""

    def make(size=(0.2, 0.3, 0.4), cells=(2, 3, 4), shake=0.2) -> TetMesh:
        counts = np.array(cells) + 1
        grid = np.array(list(itertools.product(*(range(count) for count in counts))), float)
        inner = ((grid > 0) & (grid < counts - 1)).all(axis=1)
        grid[inner] += np.random.default_rng(1).uniform(-shake, shake, (inner.sum(), 3))
        index = np.arange(len(grid)).reshape(counts)
        tets = []
        for cell in itertools.product(*(range(count) for count in cells)):
            for path in itertools.permutations(range(3)):
                corner = np.array(cell)
                tet = [index[tuple(corner)]]
                for axis in path:
                    corner[axis] += 1
                    tet.append(index[tuple(corner)])
                # The tetrahedra of odd paths are the mirror images of those of even ones.
                even = np.linalg.det(np.eye(3)[list(path)]) > 0
                tets.append(tet if even else [tet[0], tet[2], tet[1], tet[3]])
        return TetMesh(grid * np.array(size) / np.array(cells), np.array(tets))

    return make
