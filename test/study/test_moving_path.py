"""The path of lengths along which settings are compared."""

import numpy as np
import pytest

from softrobot_twin.scene import load_scene
from softrobot_twin.study.accuracy_study import length_path
from softrobot_twin.study.bench_measurement import default_scene_path


@pytest.mark.parametrize("rate", [None, np.inf, 0.05])
def test_the_path_is_finite_with_and_without_rate_limits(rate):
    scene = load_scene(default_scene_path())
    cables = tuple(cable.model_copy(update={"rate": rate}) for cable in scene.cables)
    path = length_path(scene.model_copy(update={"cables": cables}), 100.0, 20)
    assert np.isfinite(path.displacements).all() and np.ptp(path.displacements, axis=0).max() > 0.0
