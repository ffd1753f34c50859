"""Measured touches: what is accepted, what ends them, and what the loop does meanwhile."""

import math

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.inputs import TouchInput
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.simulated_device import DeviceFlaws, Fingertip, Presses, SimulatedDevice
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.errors import ParameterError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import Simulation
from test.builder import at_rest
from test.scene_changes import entries_of

FRAME = "base_link"
SETTINGS = LoopSettings(rate=20.0, touch_timeout=0.2)
PLACE = (0.012, 0.01, 0.10)


@pytest.fixture(scope="module")
def built(column):
    mapping = entries_of(
        column, {"body.mesh.file": str(column.parent / "column.vtk"), "effectors.0.directions": ["x", "y"]})
    mapping["touches"] = [
        {"name": "finger", "points": [[0.01, 0.01, 0.10]], "directions": ["x", "y"], "force_limit": 2.0}
    ]
    return Simulation(scene_from_mapping(mapping))


simulation = at_rest("built")


@pytest.fixture
def touches(simulation):
    return TouchInput(simulation, FRAME, SETTINGS)


def at(time, frame=FRAME) -> Arrival:
    stamp = round((1000.0 + time) * NANOSECONDS)
    return Arrival(frame, stamp, stamp, time)


def test_nothing_touches_before_the_first_message(touches):
    assert touches.read(0.0) is None


def test_whichever_of_force_and_place_came_last_counts(touches):
    assert touches.accept_force(0, (0.0, 0.0, -1.0), at(0.0)) is None
    assert touches.read(0.0).forces.tolist() == [[0.0, 0.0, -1.0]]
    assert touches.accept_place(0, PLACE, at(0.1)) is None
    touched = touches.read(0.1)
    assert np.isnan(touched.forces).all() and touched.places.tolist() == [list(PLACE)]
    assert touches.accept_force(0, (0.0, 1.0, 0.0), at(0.15)) is None
    assert np.isnan(touches.read(0.15).places).all()


@pytest.mark.parametrize("force", [(0.0, 0.0, 0.0), (math.nan, 0.0, 0.0), (math.nan,) * 3])
def test_a_force_of_zero_or_nan_ends_a_touch(touches, force):
    touches.accept_place(0, PLACE, at(0.0))
    assert touches.accept_force(0, force, at(0.05)) is None
    assert touches.read(0.05) is None and touches.refusals.total == 0


def test_a_place_that_is_nan_ends_a_touch(touches):
    touches.accept_force(0, (0.0, 0.0, -1.0), at(0.0))
    assert touches.accept_place(0, (math.nan,) * 3, at(0.05)) is None
    assert touches.read(0.05) is None


def test_a_touch_ends_without_messages_and_is_counted(touches):
    touches.accept_force(0, (0.0, 0.0, -1.0), at(0.0))
    assert touches.read(0.2) is not None and touches.timed_out == 0
    assert touches.read(0.21) is None and touches.timed_out == 1
    assert touches.read(0.5) is None and touches.timed_out == 1


@pytest.mark.parametrize("force, arrival, refusal", [
    ((0.0, math.inf, 0.0), at(0.1), Refusal.NOT_FINITE),
    ((0.0, 0.0), at(0.1), Refusal.WRONG_SIZE),
    ((0.0, 0.0, -2.1), at(0.1), Refusal.OUT_OF_RANGE),
    ((0.0, 0.0, -1.5), at(0.1, "other"), Refusal.WRONG_FRAME),
    ((0.0, 0.0, -1.5), at(-0.1), Refusal.OUT_OF_ORDER),
])  # fmt: skip
def test_a_force_that_cannot_be_used_is_refused_and_the_touch_stays(touches, force, arrival, refusal):
    touches.accept_force(0, (0.0, 0.0, -1.0), at(0.0))
    assert touches.accept_force(0, force, arrival) is refusal
    assert touches.refusals.of(refusal) == 1
    assert touches.read(0.1).forces.tolist() == [[0.0, 0.0, -1.0]]


@pytest.mark.parametrize(
    ("place", "refusal"),
    [((1.0, 0.0, 0.0), Refusal.OUT_OF_RANGE), ((0.0, math.inf, 0.0), Refusal.NOT_FINITE)],
)
def test_a_place_that_cannot_be_used_is_refused(touches, place, refusal):
    assert touches.accept_place(0, place, at(0.0)) is refusal
    assert touches.read(0.0) is None


def test_the_loop_answers_a_force_with_a_displacement_and_holds_its_cables(simulation):
    loop = TwinLoop(simulation, SETTINGS)
    target = simulation.effector_positions()[0] + [0.002, 0.0, 0.0]
    time = 0.0
    for _ in range(10):
        time += 0.05
        loop.targets.accept_point(0, target, at(time))
        before = loop.tick(time, at(time).ros_time)
    assert loop.touches.accept_force(0, (-0.02, 0.0, 0.0), at(time)) is None
    for _ in range(3):
        time += 0.05
        loop.targets.accept_point(0, target, at(time))
        during = loop.tick(time, at(time).ros_time)
    touches = during.result.touches
    assert touches.forces[0].tolist() == [-0.02, 0.0, 0.0]
    assert touches.displacements[0, 0] < -1e-4
    assert np.array_equal(during.command.setpoints, before.command.setpoints)
    for _ in range(6):
        time += 0.05
        loop.targets.accept_point(0, target, at(time))
        after = loop.tick(time, at(time).ros_time)
    assert not after.result.touches.is_touched.any() and loop.touches.timed_out == 1
    assert after.tracking_errors[0] < 1e-4


def test_a_reset_during_a_touch_leaves_a_model_that_the_touch_presses_again(simulation):
    loop, time = TwinLoop(simulation, SETTINGS), 0.0
    outcomes = []
    for tick in range(8):
        time += 0.05
        loop.touches.accept_force(0, (0.0, 0.02, 0.0), at(time))
        if tick == 4:
            loop.reset()
        outcomes.append(loop.tick(time, at(time).ros_time).result)
    assert all(not result.status.is_failure for result in outcomes)
    first, last = (result.touches.displacements[0, 1] for result in (outcomes[3], outcomes[-1]))
    assert first > 1e-4 and last == pytest.approx(first, rel=1e-3)


def test_a_fingertip_presses_to_its_depth_and_lets_go(simulation):
    presses = Presses("finger", 0.002, 1.0, (0.0, 1.0, 0.0))
    device = SimulatedDevice(simulation, DeviceFlaws(), presses=presses)
    depths, forces = [], []
    for tick in range(101):
        device.read(0.02 * tick)
        depths.append(device.touches().displacements[0, 1])
        forces.append(device.touches().forces[0, 1])
    depths, forces = np.array(depths), np.array(forces)
    # Readings are 0.02 s apart and miss the middle of a press by half of that.
    assert max(depths) == pytest.approx(0.002, abs=1e-5)
    assert (forces >= -1e-9).all() and forces.max() > 1e-3
    # Not touched in the first half of each period, of 50 readings.
    assert not depths[:25].any() and not forces[:25].any() and not forces[51:75].any()
    assert np.corrcoef(depths[28:48], forces[28:48])[0, 1] > 0.99


@pytest.mark.parametrize(
    ("changes", "name"),
    [({"touch": "thumb"}, "device_touch"), ({"depth": 0.0}, "device_touch_depth"),
     ({"period": math.nan}, "device_touch_period"),
     ({"direction": (0.0, 0.0, 0.0)}, "device_touch_direction")],
)  # fmt: skip
def test_a_fingertip_that_cannot_press_is_refused_by_name(simulation, changes, name):
    with pytest.raises(ParameterError, match=name):
        Fingertip(simulation, Presses(**{"touch": "finger", "depth": 0.001, "period": 1.0} | changes))
