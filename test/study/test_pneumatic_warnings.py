"""What explain warns of in pneumatic robots."""

import re
from copy import deepcopy

import numpy as np
import pytest

from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scene.body_entries import Helix
from softrobot_twin.simulation import Simulation
from softrobot_twin.study.explain import thinnest_parts
from softrobot_twin.study.pneumatic_warnings import (
    burst_warnings,
    fibre_warnings,
    thread_distance,
)
from test.scene_changes import LEFT_OUT, changed
from test.simulation.test_pneumatic_robots import robot


def helix(**entries):
    return Helix(**{"radius": 0.02, "pitch": 0.016, "reach": (0.0, 0.1), "count": 4} | entries)


def test_the_distance_of_threads_counts_all_of_both_hands():
    assert thread_distance(helix()) == pytest.approx(0.002, rel=0.01)
    assert thread_distance(helix(handedness="left")) == pytest.approx(0.004, rel=0.01)
    # Threads along the axis, nearly: they share the circumference.
    assert thread_distance(helix(pitch=100.0, handedness="right")) == pytest.approx(
        2.0 * np.pi * 0.02 / 4, rel=1e-3)


@pytest.mark.sampled
@pytest.mark.parametrize("pitch, warns", [(0.016, False), (0.030, False), (0.036, True)])
def test_threads_that_are_further_apart_than_two_walls_are_warned_of(pitch, warns):
    segment = robot("segment", changed({"fibres.0.helix.pitch": pitch}))
    found = list(fibre_warnings(segment, thinnest_parts(segment)))
    assert len(found) == warns
    if warns:
        assert re.search(r"fibres hoops: 4\.\d+ mm .* wall of 1\.9\d mm", found[0])


@pytest.mark.exhaustive
def test_a_robot_of_the_package_is_far_from_bursting_at_all_its_pressures():
    assert not list(burst_warnings(robot("pneunet_inverse")))


@pytest.mark.exhaustive
def test_without_fibres_the_walls_of_the_segment_come_near_a_burst():
    bare = robot("segment", changed({"fibres": LEFT_OUT, "cavities.*.pressure": [0.0, 40e3]}))
    found = list(burst_warnings(bare))
    assert found and found[0].startswith("chamber_1: at ")


def test_cables_and_syringes_stay_at_rest_while_cavities_are_driven(air_scene):
    """The cable would be pulled to a quarter of its length, were its setpoint scaled with the pressure."""
    scene = deepcopy(air_scene)
    scene["cavities"][0] |= {"pressure_offset": 150.0, "pressure_gain": 0.9}
    simulation = Simulation(scene_from_mapping(scene))
    setpoints = []
    simulation.step = lambda command, step=simulation.step: setpoints.append(command.setpoints) or step(command)
    assert not list(burst_warnings(simulation))
    told = np.array(setpoints)
    assert (told[:, [0, 3]] == simulation.rest_setpoints[[0, 3]]).all()
    assert told[:, 1].max() == pytest.approx(150.0 + 2.0e4 / 0.9)


def test_in_motion_nothing_is_driven():
    assert not list(burst_warnings(robot("pneunet")))
