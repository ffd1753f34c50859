"""The Grasper holds its cube: lifted off the floor, it does not creep for 10 s."""

from pathlib import Path

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, Simulation, Status

SCENE_FILE = Path(__file__).resolve().parents[2] / "config" / "scenes" / "grasper.yaml"
STEP, WOUND, LIFT = 0.008, 0.016, 0.050


@pytest.mark.exhaustive
def test_a_grasped_cube_does_not_creep_for_ten_seconds():
    simulation = Simulation.from_scene_file(SCENE_FILE)
    cube = next(part for part in simulation.model.rigid if part.name == "cube")
    wound = CommandSetpoints(simulation.rest_setpoints - WOUND, STEP)
    palm = np.array([0.0, 0.0, 0.0])

    def run(seconds, height):
        simulation.model.guides.aim("palm", palm + [0, 0, height])
        places = []
        for _ in range(round(seconds / STEP)):
            result = simulation.step(wound)
            assert not result.status.is_failure and result.status is not Status.INVERTED
            places.append(result.state.positions[cube.first_node])
        return np.array(places), result

    gripped, _ = run(WOUND / 0.02 + 1.5, 0.0)
    lifted, _ = run(LIFT / 0.05 + 1.5, LIFT)
    assert lifted[-1, 2] - gripped[-1, 2] == pytest.approx(LIFT, abs=4e-4)
    held, result = run(10.0, LIFT)
    # Its remaining oscillation is averaged over half a second at both ends.
    window = round(0.5 / STEP)
    creep = held[-window:].mean(axis=0) - held[:window].mean(axis=0)
    assert np.abs(creep).max() < 1e-7
    assert np.ptp(held[-window:], axis=0).max() < 1e-7
    # Held by the fingers alone, with its whole weight.
    names = result.contacts.names
    on_cube = np.zeros(3)
    for force, pair in zip(result.contacts.forces, result.contacts.pairs, strict=True):
        assert "floor" not in names[pair]
        on_cube += force if names[pair][0] == "cube" else -force
    assert on_cube[2] == pytest.approx(0.030 * 9.81, rel=1e-4)
