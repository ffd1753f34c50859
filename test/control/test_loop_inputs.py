"""A loop builds the inputs that its scene and its mode call for, and no others."""

import copy

import numpy as np
import pytest

from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation

ALWAYS = {"markers", "device"}
OF_MODE = {Mode.DIRECT: {"direct"}, Mode.INVERSE: {"selected", "targets"}}


def inputs_of(simulation, mode):
    return TwinLoop(simulation, LoopSettings(), mode).inputs


def changed(mapping, **entries):
    return Simulation(scene_from_mapping(copy.deepcopy(mapping) | entries))


@pytest.mark.parametrize("mode", Mode)
def test_a_robot_of_cables_has_the_inputs_of_its_mode(simulation, mode):
    assert inputs_of(simulation, mode).keys() == ALWAYS | OF_MODE[mode]


@pytest.mark.parametrize("mode", Mode)
def test_cavities_add_their_pressures(air, mode):
    added = {"pressures", "measured_pressures"}
    assert inputs_of(air, mode).keys() == ALWAYS | OF_MODE[mode] | added


def test_guided_bodies_add_their_poses(grasper):
    assert inputs_of(grasper, Mode.DIRECT).keys() == ALWAYS | OF_MODE[Mode.DIRECT] | {"poses"}


def test_pulleys_add_their_angles(small_scene_mapping):
    cables = [dict(cable, pulley={"radius": 0.01}) for cable in small_scene_mapping["cables"]]
    wound = changed(small_scene_mapping, cables=cables)
    added = {"angles", "measured_angles"}
    assert inputs_of(wound, Mode.DIRECT).keys() == ALWAYS | OF_MODE[Mode.DIRECT] | added


def test_touches_add_their_forces_and_places(small_scene_mapping):
    points = small_scene_mapping["effectors"][0]["points"]
    touch = {"name": "finger", "points": points, "force_limit": 2.0}
    touched = changed(small_scene_mapping, touches=[touch])
    assert inputs_of(touched, Mode.DIRECT).keys() == ALWAYS | OF_MODE[Mode.DIRECT] | {"touches"}


def test_stiffnesses_are_taken_where_targets_are(small_scene_mapping):
    effectors = [small_scene_mapping["effectors"][0] | {"stiffness": {"weight": 1.0}}]
    stiff = changed(small_scene_mapping, effectors=effectors)
    asked = ALWAYS | OF_MODE[Mode.INVERSE] | {"stiffness"}
    assert inputs_of(stiff, Mode.INVERSE).keys() == asked
    assert inputs_of(stiff, Mode.DIRECT).keys() == ALWAYS | OF_MODE[Mode.DIRECT]


@pytest.mark.parametrize("mode", Mode)
def test_each_input_is_an_attribute_and_what_is_not_built_is_none(simulation, mode):
    loop = TwinLoop(simulation, LoopSettings(), mode)
    assert loop.inputs.keys() < TwinLoop.__annotations__.keys()
    for name in TwinLoop.__annotations__:
        assert getattr(loop, name) is loop.inputs.get(name)


def test_changed_settings_reach_all_inputs(air):
    loop = TwinLoop(air, LoopSettings(), Mode.INVERSE)
    loop.apply(LoopSettings(message_timeout=7.0))
    assert {one.settings.message_timeout for one in loop.inputs.values()} == {7.0}


def test_a_direct_loop_reports_that_it_has_no_targets(simulation):
    loop = TwinLoop(simulation, LoopSettings(), Mode.DIRECT)
    reading = loop.tick(0.0, 10**9).reading
    assert reading.source == "none" and reading.age == np.inf and not reading.timed_out
    assert np.isnan(reading.targets).all() and reading.targets.shape == (1, 3)
