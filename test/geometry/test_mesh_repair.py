import numpy as np
import pytest

from softrobot_twin.geometry.mesh_repair import enclose_volume

pytestmark = pytest.mark.libraries

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0]], float)


def test_flat_and_collapsed_tets_enclose_no_volume():
    tets = np.array([[0, 1, 2, 4], [0, 1, 2, 3], [0, 1, 1, 3], [0, 2, 1, 3]])
    assert enclose_volume(CORNERS, tets).tolist() == [False, True, False, True]


def test_flatness_does_not_depend_on_size():
    thin = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.3, 0.3, 1e-6]])
    for scale in (1e-6, 1.0, 1e6):
        assert enclose_volume(scale * thin, np.array([[0, 1, 2, 3]])).all()
