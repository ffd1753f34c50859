"""Row 34: what nothing holds is named at load in statics; in motion it falls."""

import numpy as np
import pytest

from softrobot_twin.errors import SceneError
from softrobot_twin.simulation import Hold, Status
from test.scene_changes import repeat_step, solved


@pytest.fixture
def soft(body_of, block):
    """The entry of a soft body that nothing holds."""
    return body_of(block(size=(0.04, 0.04, 0.06), cells=(1, 1, 2)))


def test_of_several_bodies_the_floating_one_is_named(simulate, soft, body_of, block):
    held = body_of(
        block(size=(0.04, 0.04, 0.06), cells=(1, 1, 2)), name="held",
        fixed=[{"box": {"minimum": [-1, -1, -1e-6], "maximum": [1, 1, 1e-6]}}],
    )  # fmt: skip
    with pytest.raises(SceneError, match=r"bodies\[1\]\.fixed"):
        simulate(bodies=[held, soft])


def test_a_point_mass_held_by_a_spring_to_ground_is_not_floating(simulate):
    scene = simulate(
        mass_springs=[{"name": "bob", "points": [[0, 0, 0]], "masses": [0.1]}],
        springs=[{"name": "string", "stiffness": 100.0,
                  "ends": [{"on": "bob", "point": [0, 0, 0]}, {"point": [0.05, 0, 0]}]}],
        solver={"newton_iterations": 1},
    )  # fmt: skip
    # A single point has no size, by which a move would be round-off: on the way it is in no balance.
    assert repeat_step(scene, Hold(), 2).status is Status.NOT_CONVERGED
    result = solved(scene, Hold(), 100)
    # Let go beside the point it hangs on, it ends below it.
    np.testing.assert_allclose(result.state.positions, [[0.05, 0.0, -0.05 - 0.1 * 9.81 / 100.0]], atol=1e-7)


@pytest.mark.parametrize("integration", ["first_order", "dynamic"])
def test_an_unheld_soft_body_falls_undeformed_in_dynamics(simulate, soft, integration):
    """With a drag α in the air it comes to fall at g/α."""
    scene = simulate(body={**soft, "damping": {"mass": 5.0}}, integration=integration)
    shape = scene.model.nodes.rest_positions - scene.model.nodes.rest_positions[0]
    for _ in range(60):
        result = solved(scene, Hold(0.05))
        positions = result.state.positions
        np.testing.assert_allclose(positions - positions[0], shape, atol=1e-9)
    np.testing.assert_allclose(
        result.state.velocities, [[0, 0, -9.81 / 5.0]] * len(shape), atol=1e-5
    )
