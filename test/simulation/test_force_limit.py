"""The limit on contact force in the inverse problem: it holds wherever it is feasible."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Status
from test.scene_changes import repeat_step

LIMITS = (2.0, 0.8, 0.5, 0.3, 0.1, 0.03, 0.01)


def lean(simulation, target, steps=80):
    return repeat_step(simulation, FollowTargets(target, 0.05), steps)


def pushes(result) -> np.ndarray:
    return np.linalg.norm(result.contacts.forces, axis=1)


def behind(simulation):
    return simulation.effector_positions() + [0.03, 0.0, -0.012]


def over_limit(result) -> list[str]:
    return [name for name in result.report.active_limits if name.endswith("force_limit_exceeded")]


@pytest.mark.exhaustive
def test_a_lower_force_limit_presses_less_and_ends_further_from_the_target(beam, rod):
    errors, forces = [], []
    for limit in LIMITS:
        simulation = beam(lambda m, f=limit: rod(m, z=0.05, force_limit=f))
        result = lean(simulation, behind(simulation))
        assert pushes(result).max(initial=0.0) <= limit * (1 + 1e-6)
        assert not over_limit(result)
        errors.append(result.effector_errors[0])
        forces.append(pushes(result).max(initial=0.0))
    # The first does not bind; all others do. The second binds so little that what the linearization
    # leaves out, the turning of a normal that carries force, counts for as much [m].
    assert forces[0] < 0.95 * LIMITS[0]
    np.testing.assert_allclose(forces[1:], LIMITS[1:], rtol=1e-4)
    assert np.all(np.diff(errors[1:]) > 5e-5)
    assert errors[1] > errors[0] - 3e-6


def test_a_limit_that_holds_the_robot_back_is_named(beam, rod):
    for limit, status in ((2.0, Status.UNREACHABLE), (0.3, Status.SATURATED)):
        simulation = beam(lambda m, f=limit: rod(m, z=0.05, force_limit=f))
        result = lean(simulation, behind(simulation))
        assert result.status is status
        assert ("beam.rod.force_limit" in result.report.active_limits) == (limit == 0.3)


def test_a_limit_that_does_not_bind_changes_nothing(beam, rod):
    free = beam(lambda m: rod(m, z=0.05))
    limited = beam(lambda m: rod(m, z=0.05, force_limit=50.0))
    one, other = lean(free, behind(free)), lean(limited, behind(limited))
    np.testing.assert_allclose(other.setpoints, one.setpoints, atol=1e-8)
    np.testing.assert_allclose(other.contacts.forces, one.contacts.forces, atol=1e-5)


def test_the_limit_holds_during_the_approach_and_along_the_rod(beam, rod):
    simulation = beam(lambda m: rod(m, z=0.05, force_limit=0.1))
    home = simulation.effector_positions()
    for step in range(150):
        target = home + [0.03, 0.008 * np.sin(step / 20), -0.012]
        result = simulation.step(FollowTargets(target, 0.02))
        assert pushes(result).max(initial=0.0) <= 0.1 * (1 + 1e-6)
        assert not over_limit(result)


def wedged(beam, rod, limit):
    """A beam between two rods, both of which stand a little inside it."""

    def change(mapping):
        rod(mapping, x=0.0245, z=0.05, name="right", force_limit=limit, push_out_speed=10.0)
        rod(mapping, x=-0.0045, z=0.05, name="left")

    return beam(change)


def test_an_infeasible_limit_is_named_and_exceeded_by_the_least(beam, rod):
    held = wedged(beam, rod, None)
    for _ in range(60):
        pressed = held.step(CommandSetpoints(held.rest_setpoints, 0.05))
    assert pushes(pressed).max() > 0.2
    simulation = wedged(beam, rod, 0.02)
    home = simulation.effector_positions()
    result = lean(simulation, home + [0.0, 0.004, -0.001])
    assert set(over_limit(result)) <= {"beam.right.force_limit_exceeded", "beam.left.force_limit_exceeded"}
    assert len(over_limit(result)) == 2
    # The tip still serves its target as far as the first goal leaves it free.
    assert 0.02 < pushes(result).max() < 1.05 * pushes(pressed).max()
    assert result.status in (Status.SATURATED, Status.RATE_LIMITED, Status.OK)


def test_forces_are_continuous_as_a_limit_becomes_infeasible(beam, rod):
    """Row 15: targets move slowly out of reach and back: no force drops to zero."""
    simulation = wedged(beam, rod, 0.02)
    inverse = simulation.inverse
    home = simulation.effector_positions()
    result = lean(simulation, home + [0.0, 0.004, -0.001])
    total, named = [pushes(result).sum()], []
    for limit in np.concatenate([np.linspace(4.0, 20.0, 60), np.linspace(20.0, 4.0, 60)]):
        inverse.force_limit = limit
        result = lean(simulation, home + [0.0, 0.004, -0.001], 1)
        total.append(pushes(result).sum())
        named.append(bool(over_limit(result)))
    assert min(total) > 0.1
    assert np.abs(np.diff(total)).max() < 0.1 * max(total)
    # Named while it cannot be kept, not named while it can, and never to and fro.
    assert named[0] and named[-1] and not named[60]
    assert np.count_nonzero(np.diff(named)) == 2
