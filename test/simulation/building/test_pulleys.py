"""Facts of pulleys that wind cables."""

import numpy as np
import pytest

from softrobot_twin.simulation import CommandSetpoints, FollowTargets, Status
from test.scene_changes import repeat_step

RADIUS = 0.0083


def wound(*pulleys, **motor):
    """Pulleys of the first cables; a motor of the last two."""

    def change(mapping):
        for cable, pulley in zip(mapping["cables"], pulleys):
            cable["pulley"] = {"radius": RADIUS, **pulley}
        if motor:
            mapping["motors"] = [
                {"name": "m", "cables": ["west", "south"], "pulley": {"radius": RADIUS, **motor}}
            ]

    return change


def step(simulation, *shortenings, time_step=10.0):
    lengths = simulation.rest_setpoints - np.array(shortenings)
    return simulation.step(CommandSetpoints(lengths, time_step))


@pytest.mark.parametrize("winds, sign", [("positive", 1.0), ("negative", -1.0)])
def test_an_angle_is_the_wound_length_by_the_radius_to_the_bit(beam, winds, sign):
    simulation = beam(wound({"winds": winds}))
    pulleys = simulation.pulleys
    assert pulleys.names == ("east",) and pulleys.is_wound.tolist() == [True, False, False, False]
    result = step(simulation, 0.007, 0.002, 0.0, 0.0)
    length, rest = result.setpoints[0], simulation.rest_setpoints[0]
    assert pulleys.angles(result.setpoints).tolist() == [sign * ((rest - length) / RADIUS)]
    assert pulleys.torques(result.efforts).tolist() == [sign * RADIUS * result.efforts[0]]
    angle = 0.31
    assert pulleys.lengths(0, angle).tolist() == [rest - sign * RADIUS * angle]
    assert pulleys.tensions(0, sign * RADIUS * 4.0) == pytest.approx(4.0)


def test_a_pulley_of_a_motor_winds_all_its_cables_by_one_length(beam):
    simulation = beam(wound({}, radius=0.01, winds="negative"))
    pulleys = simulation.pulleys
    assert pulleys.names == ("east", "m")
    lengths = simulation.rest_setpoints.copy()
    lengths[pulleys.driven[1]] = pulleys.lengths(1, -0.5)
    result = simulation.step(CommandSetpoints(lengths, 1.0))
    np.testing.assert_allclose(result.displacements, [0.0, 0.0, 0.005, 0.005], atol=1e-15)
    assert pulleys.angles(result.setpoints) == pytest.approx([0.0, -0.5], abs=1e-12)
    assert pulleys.torques(result.efforts)[1] == pytest.approx(-0.01 * result.efforts[2:].sum())


@pytest.mark.parametrize("winds, ends", [("positive", [-0.2, 0.6]), ("negative", [-0.6, 0.2])])
def test_limits_of_angle_and_speed_are_those_of_shortening_and_rate(beam, winds, ends):
    def change(mapping):
        wound({"winds": winds, "angle": ends, "rate": 2.0})(mapping)
        mapping["cables"][0].update(shortening=[None, None], rate=None)

    limits = beam(change).limits
    assert limits.displacement_min[0] == pytest.approx(-0.2 * RADIUS)
    assert limits.displacement_max[0] == pytest.approx(0.6 * RADIUS)
    assert limits.rate[0] == 2.0 * RADIUS
    words = ("angle_min", "angle_max") if winds == "positive" else ("angle_max", "angle_min")
    assert limits.limit_names[0] == words
    assert limits.limit_names[1] == ("shortening_min", "shortening_max")


def test_the_narrower_limit_of_length_and_angle_holds(beam):
    limits = beam(wound({"angle": [-1.0, 0.5], "rate": 100.0}, {"angle": [0.0, 9.0]})).limits
    assert limits.displacement_min[0] == 0.0
    assert limits.displacement_max[0] == pytest.approx(0.5 * RADIUS)
    assert limits.limit_names[0] == ("shortening_min", "angle_max")
    assert limits.displacement_max[1] == 0.02 and limits.rate[0] == 0.05
    assert limits.limit_names[1] == ("shortening_min", "shortening_max")


@pytest.mark.parametrize("winds, end, name", [
    ("positive", [0.0, 0.4], "east.angle_max"), ("negative", [-0.4, 0.0], "east.angle_min"),
])  # fmt: skip
def test_a_target_beyond_an_angle_limit_names_it(beam, winds, end, name):
    simulation = beam(wound({"winds": winds, "angle": end}))
    # Far to the side to which east bends the beam.
    result = repeat_step(simulation, FollowTargets(np.array([[0.06, 0.01, 0.09]]), 1.0), 30)
    assert result.status is Status.SATURATED
    assert name in result.report.active_limits
    assert abs(simulation.pulleys.angles(result.setpoints)[0]) == pytest.approx(0.4, abs=1e-6)


def test_a_command_beyond_an_angle_limit_stops_there(beam):
    simulation = beam(wound({"angle": [0.0, 0.4]}))
    result = step(simulation, 0.015, 0.0, 0.0, 0.0)
    assert simulation.pulleys.angles(result.setpoints)[0] == pytest.approx(0.4, abs=1e-9)
    assert "east.angle_max" in result.report.active_limits
