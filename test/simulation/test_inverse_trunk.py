"""Facts of the coarse Trunk in the inverse: between two cylinders."""

import numpy as np
import pytest

from softrobot_twin.simulation import FollowTargets
from test.places import CONFIG
from test.scene_changes import LEFT_OUT, changed, entries_of

SCENE = entries_of(CONFIG / "scenes" / "trunk_cylinders.yaml",
                   {"body.mesh.file": "../../meshes/trunk_1600.vtk", "body.element": "linear"})
PATH = np.genfromtxt(CONFIG / "targets" / "trunk_path.csv", delimiter=",", skip_header=1)[:, 1:4]
CYLINDERS = [entry["cylinder"] for entry in SCENE["obstacles"]]


without_cylinders = changed({"obstacles": LEFT_OUT, "contact": LEFT_OUT})


def gaps(simulation) -> list[float]:
    """Least distance of surface points from each cylinder [m]."""
    corners = simulation.surface_positions()[simulation.surface_triangles]
    weights = np.vstack([np.eye(3), 0.5 * (1.0 - np.eye(3)), np.full((1, 3), 1 / 3)])
    points = np.einsum("gk,tki->gti", weights, corners).reshape(-1, 3)
    found = []
    for cylinder in CYLINDERS:
        first, last = np.array(cylinder["ends"])
        axis = (last - first) / np.linalg.norm(last - first)
        away = points - first
        away -= np.outer(away @ axis, axis)
        found.append(np.linalg.norm(away, axis=1).min() - cylinder["radius"])
    return found


@pytest.mark.exhaustive
def test_the_path_between_the_cylinders_crosses_neither_and_would_without_contact(coarse_trunk):
    """Row 26, by the demo's own path."""
    simulation, blind = coarse_trunk(), coarse_trunk(without_cylinders)
    worst, crossed, touched = [], [], 0
    for target in PATH:
        result = simulation.step(FollowTargets(target[None], 0.05))
        blind.step(FollowTargets(target[None], 0.05))
        assert not result.status.is_failure
        touched += result.report.contact_count > 0
        worst.append(min(gaps(simulation)))
        crossed.append(min(gaps(blind)))
    print(f"least gap {1e3 * min(worst):.4f} mm, without contact {1e3 * min(crossed):.2f} mm, "
          f"touching in {touched} of {len(PATH)} steps")  # fmt: skip
    assert touched > 10
    assert min(worst) > -5e-5
    assert min(crossed) < -1e-3
