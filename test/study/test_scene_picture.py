"""Snapshots contain solids of all kinds of objects at their positions."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Simulation
from softrobot_twin.study.scene_picture import FREE_COLOUR, GUIDED_COLOUR, take_snapshot
from test.scene_changes import repeat_step


def test_a_snapshot_shows_every_body_at_its_position(stamp):
    simulation = Simulation.from_scene_file(stamp)
    simulation.model.guides.aim("press", [0.0, 0.0, -0.002])
    result = repeat_step(simulation, Hold(0.01), 4)
    shot = take_snapshot(simulation, result.contacts, "pressed")

    def height(colour):
        return [np.ptp(solid.triangles.reshape(-1, 3)[:, 2]) for solid in shot.solids
                if solid.look == "rigid" and np.array_equal(solid.colour, colour)]

    assert height(FREE_COLOUR) == pytest.approx([0.03], abs=1e-6)
    assert height(GUIDED_COLOUR) == pytest.approx([0.01])
    (mesh,) = [solid for solid in shot.solids if solid.look == "mesh"]
    assert mesh.triangles[..., 2].max() == pytest.approx(0.051 - 0.002, abs=1e-9)
    ((point, normal),) = shot.planes
    assert point @ normal == 0.0 and normal[2] == 1.0
    assert len(shot.forces[0]) == result.report.contact_count > 0
