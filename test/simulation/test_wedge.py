"""A soft body pushed in between two cylinders: neither is entered."""

import numpy as np
import pytest

from softrobot_twin.simulation import Hold, Status


@pytest.mark.parametrize("friction", [0.0, 0.3])
@pytest.mark.parametrize("integration", ["quasi_static", "dynamic"])
def test_a_body_wedged_between_two_cylinders_enters_neither(
    scene_of, write_block, integration, friction
):
    """A block of 20 mm, its top on a guided plate, is pressed into a gap of 16 mm."""
    step, ends = 0.01, ([0, -0.05, 0], [0, 0.05, 0])
    simulation = scene_of(
        gravity=[0, 0, 0], integration=integration,
        body={
            "name": "soft",
            "mesh": {"file": write_block((0.02, 0.02, 0.04), (4, 4, 8)),
                     "translation": [0.0005, 0, 0.03]},
            "material": {"young_modulus": 1e5, "poisson_ratio": 0.3, "density": 1000.0},
            "damping": {"mass": 20.0},
            "attached": [{"to": "plate", "box": {"minimum": [-1, -1, 0.0499],
                                                 "maximum": [1, 1, 1]}}],
        },
        rigid_bodies=[{"name": "plate", "motion": "guided", "speed": 0.02,
                       "position": [0, 0, 0.06], "box": {"size": [0.05, 0.05, 0.02]}}],
        obstacles=[{"name": "left", "position": [-0.018, 0, 0],
                    "cylinder": {"ends": ends, "radius": 0.01}},
                   {"name": "right", "position": [0.018, 0, 0],
                    "cylinder": {"ends": ends, "radius": 0.01}}],
        contact={"friction": friction, "between": [{"pair": ["soft", "left"]},
                                                   {"pair": ["soft", "right"]}]},
        solver={"newton_iterations": 3},
    )  # fmt: skip
    simulation.model.guides.aim("plate", [0, 0, 0.05])
    contacts, deepest, solved = simulation.model.contacts, [], 0
    for _ in range(100):
        result = simulation.step(Hold(step))
        assert result.status in (Status.OK, Status.NOT_CONVERGED)
        solved += result.status is Status.OK
        contacts.detect(result.state.positions)
        deepest.append(contacts.gaps(result.state.positions).min(initial=1.0))
    contacts.detect(result.state.positions)
    for pair in (0, 1):
        gaps = contacts.gaps(result.state.positions)[contacts.pair[: contacts.count] == pair]
        assert gaps.min() > -1e-5 and gaps.min() < 1e-6
    assert min(deepest) > -1e-4
    touch = result.contacts
    sides = [touch.forces[touch.pairs == pair].sum(axis=0) for pair in (0, 1)]
    assert sides[0][0] > 0.1 and sides[1][0] < -0.1
    assert sides[0][2] > 0.1 and sides[1][2] > 0.1
    assert solved >= 90
