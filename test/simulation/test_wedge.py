"""A soft body pushed in between two cylinders: neither is entered."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Status
from test.builder import builder

pytestmark = pytest.mark.sampled

STEP, ENDS = 0.01, ([0, -0.05, 0], [0, 0.05, 0])


@builder
def wedged(scene_of, soft_block, /, integration, friction):
    """A block of 20 mm, its top on a guided plate, pressed into a gap of 16 mm.

    Gives the last result, the gaps of all steps, and whether each converged.
    """
    simulation = scene_of(
        gravity=[0, 0, 0], integration=integration,
        body=soft_block("soft", (0.02, 0.02, 0.04), (4, 4, 8), [0.0005, 0, 0.03], damping={"mass": 20.0},
                        attached=[{"to": "plate", "box": {"minimum": [-1, -1, 0.0499], "maximum": [1, 1, 1]}}]),
        rigid_bodies=[{"name": "plate", "motion": "guided", "speed": 0.02,
                       "position": [0, 0, 0.06], "box": {"size": [0.05, 0.05, 0.02]}}],
        obstacles=[{"name": name, "position": [x, 0, 0],
                    "cylinder": {"ends": ENDS, "radius": 0.01}}
                   for name, x in (("left", -0.018), ("right", 0.018))],
        contact={"friction": friction, "between": [{"pair": ["soft", "left"]},
                                                   {"pair": ["soft", "right"]}]},
        solver={"newton_iterations": 4},
    )  # fmt: skip
    simulation.model.guides.aim("plate", [0, 0, 0.05])
    gaps, is_done = [], []
    for _ in range(100):
        result = simulation.step(Hold(STEP))
        assert result.status in (Status.OK, Status.LINEARIZED, Status.NOT_CONVERGED)
        gaps.append(_least_gaps(simulation))
        is_done.append(result.status is not Status.NOT_CONVERGED)
    return result, np.array(gaps), np.array(is_done)


def _least_gaps(simulation) -> list[float]:
    """True gap to either cylinder, detected anew at the state [m]."""
    contacts = simulation.model.contacts
    contacts.detect(simulation.state.positions)
    gaps = contacts.gaps(simulation.state.positions)
    pair = contacts.pair[: contacts.count]
    return [gaps[pair == side].min(initial=1.0) for side in (0, 1)]


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_body_wedged_between_two_cylinders_stays_outside_both(wedged, integration, friction):
    result, gaps, is_done = wedged(integration, friction)
    # It is pressed in by 2 mm on either side, 0.2 mm a step.
    assert gaps[is_done].min() > -1e-6
    # With friction many steps do not converge in four iterations, which their statuses tell; how
    # processors round decides what these leave, 0.3 to 1.7 micrometres.
    assert gaps.min() > (-5e-6 if friction else -1e-6)
    assert np.all(gaps[-1] < 1e-5)
    touch = result.contacts
    sides = [touch.forces[touch.pairs == pair].sum(axis=0) for pair in (0, 1)]
    assert sides[0][0] > 0.1 and sides[1][0] < -0.1
    assert sides[0][2] > 0.1 and sides[1][2] > 0.1


@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_a_wedged_body_at_rest_enters_neither_cylinder(wedged, integration, friction):
    _, gaps, _ = wedged(integration, friction)
    assert gaps[-1].min() > -1e-7
