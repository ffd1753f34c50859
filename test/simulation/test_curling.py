"""The Grasper's finger and the Octoleg curl to the side on which their notches open."""

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation
from test.places import MESHES
from test.scene_changes import solved

OUTWARD = [(-x, 12.5, 2.5) for x in (17.5, 32.5, 47.5, 62.5, 77.5)]
TURN = [(-83.5, 12.5, 4.5), (-85.5, 12.5, 6.5), (-85.5, 12.5, 8.5), (-83.5, 12.5, 10.5)]
BACK = [(x, y, 15.0 - z) for x, y, z in reversed(OUTWARD)]
OCTOLEG_CABLE = [
    (48.27, 24.54), (66.97, 13.55), (70.52, 11.88), (82.09, 6.00), (84.77, 3.42),
    (96.34, -4.23), (99.91, -7.67), (111.52, -20.65), (114.19, -23.23), (124.02, -36.26),
    (125.82, -39.75), (133.88, -54.61), (135.68, -58.10), (142.85, -72.09), (143.76, -74.73),
]  # fmt: skip


def weightless(mesh, young_modulus, poisson_ratio, box, pull_point, points, tip) -> Simulation:
    """A body with one cable and no gravity; lengths in millimetres."""
    minimum, maximum = (1e-3 * np.array(box)).tolist()
    material = {"young_modulus": young_modulus, "poisson_ratio": poisson_ratio, "density": 1070.0}
    cable = {
        "name": "cable", "pull_point": (1e-3 * np.array(pull_point)).tolist(),
        "points": (1e-3 * np.array(points)).tolist(), "shortening": [0.0, 0.04],
        "tension": [0.0, 50.0],
    }  # fmt: skip
    scene = {
        "name": "curl", "gravity": [0.0, 0.0, 0.0],
        "body": {
            "mesh": {"file": str(MESHES / mesh)}, "element": "linear", "material": material,
            "fixed": [{"box": {"minimum": minimum, "maximum": maximum}}],
        },
        "cables": [cable],
        "effectors": [{"name": "tip", "points": [(1e-3 * np.array(tip)).tolist()]}],
        "solver": {"newton_iterations": 20},
    }  # fmt: skip
    return Simulation(scene_from_mapping(scene))


def tips(simulation, shortenings) -> np.ndarray:
    """Places of the tip [mm] at each shortening [mm], in order."""
    places = []
    for shortening in shortenings:
        solved(simulation, CommandSetpoints(simulation.rest_setpoints - 1e-3 * shortening, 1.0))
        places.append(1e3 * simulation.effector_positions()[0])
    return np.array(places)


@pytest.mark.parametrize("size", [158, 400])
def test_a_finger_curls_to_the_side_of_its_cable_and_stays_in_its_plane(size):
    simulation = weightless(
        f"grasper_finger_{size}.vtk", 600e3, 0.45, ((-15, 0, 0), (5, 10, 15)),
        (0.0, 12.5, 2.5), OUTWARD + TURN + BACK, (-103.4, 15.0, 7.5),
    )  # fmt: skip
    path = tips(simulation, range(0, 41, 4))
    assert (np.diff(path[:, 0]) > 0.0).all()
    # The tip rises along an arc, until the finger stands upright.
    assert (np.diff(path[:8, 1]) > 0.0).all()
    assert path[5, 1] - path[0, 1] > 40.0
    assert path[-1, 0] > -40.0
    np.testing.assert_allclose(path[:, 2], 7.5, atol=0.1)


def test_the_octoleg_curls_inwards_and_its_notches_close():
    simulation = weightless(
        "octoleg_120.vtk", 200e3, 0.3, ((50, -20, 30), (75, 20, 50)),
        (40.0, 0.0, 2.0), [(x, 0.0, z) for x, z in OCTOLEG_CABLE], (161.5, 0.0, -100.0),
    )  # fmt: skip
    cable = simulation.model.actuators.terms[0].paths[0]
    before = cable.positions(simulation.state.positions)
    path = tips(simulation, range(0, 11))
    after = cable.positions(simulation.state.positions)
    assert path[-1, 0] - path[0, 0] < -50.0
    assert (np.diff(path[:, 0]) < 0.0).all()
    # The coarse mesh is not quite symmetric.
    assert np.abs(path[:, 1]).max() < 1.0
    stretches = [np.linalg.norm(np.diff(p, axis=0), axis=1)[2::2] for p in (before, after)]
    assert (stretches[1] < stretches[0]).all()
