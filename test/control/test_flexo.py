"""The Flexo's demo in simulated time: its tip is led while its hand opens and closes."""

import numpy as np
import pytest
import yaml

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.simulated_device import DeviceFlaws, SimulatedDevice
from softrobot_twin.control.target_path import Circle, RampedIn, ToAndFro
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.simulation import Simulation
from test.places import CONFIG

GIVEN = yaml.safe_load((CONFIG / "flexo.yaml").read_text())["/**"]["ros__parameters"]
PERIOD, START = 1.0 / GIVEN["rate"], 1_000 * NANOSECONDS


@pytest.fixture(scope="module")
def twin_and_robot():
    return [Simulation.from_scene_file(CONFIG / GIVEN[key])
            for key in ("scene_file", "device_scene_file")]  # fmt: skip


def errors_of_a_run(twin, robot, closed_loop, seconds=11.0, after=5.0):
    """Distances of the robot's tip and of the model's from the target, and the hand's lengths."""
    twin.reset()
    robot.reset()
    loop = TwinLoop(twin, LoopSettings(
        rate=GIVEN["rate"], closed_loop=closed_loop, correction_gain=GIVEN["correction_gain"],
        correction_limit=GIVEN["correction_limit"], workspace_min=GIVEN["workspace_min"],
        workspace_max=GIVEN["workspace_max"],
    ))  # fmt: skip
    device = SimulatedDevice(robot, DeviceFlaws(
        delay=GIVEN["device_delay"], servo_rate=GIVEN["device_servo_rate"],
        marker_noise=GIVEN["device_marker_noise"], seed=GIVEN["device_seed"],
    ))  # fmt: skip
    circle = Circle(GIVEN["target_center"], GIVEN["target_radius"], GIVEN["target_period"])
    path = RampedIn(twin.effector_positions()[0].copy(), circle, GIVEN["target_ramp_time"])
    hand = ToAndFro(tuple(GIVEN["target_setpoints"]), GIVEN["target_setpoint_period"])
    every, found = round(GIVEN["rate"] / GIVEN["device_rate"]), []
    for tick in range(round(seconds / PERIOD)):
        time = tick * PERIOD
        now = START + round(time * NANOSECONDS)
        arrival = Arrival("base_link", now, now, time)
        target = path.position(time)
        assert loop.targets.accept_point(0, target, arrival) is None
        assert loop.selected.accept([GIVEN["target_actuator"]], [hand.value(time)], [], arrival) is None
        outcome = loop.tick(time, now)
        device.apply(outcome.command.setpoints, time)
        if tick % every == 0:
            reading = device.read(time)
            loop.markers.accept(twin.marker_ids, reading.marker_positions, arrival)
            if time >= after:
                found.append([
                    np.linalg.norm(reading.effector_positions[0] - target),
                    np.linalg.norm(twin.effector_positions()[0] - target), twin.state.setpoints[-1],
                ])  # fmt: skip
    return np.array(found).T


@pytest.mark.exhaustive
def test_the_closed_loop_leads_the_robot_while_its_hand_opens_and_closes(twin_and_robot):
    opened, model, lengths = errors_of_a_run(*twin_and_robot, closed_loop=False)
    closed, _, _ = errors_of_a_run(*twin_and_robot, closed_loop=True)
    print(f"open {1e3 * opened.mean():.2f} / {1e3 * opened.max():.2f} mm, closed "
          f"{1e3 * closed.mean():.2f} / {1e3 * closed.max():.2f} mm, model {1e3 * model.max():.4f} mm")
    assert np.ptp(lengths) > 0.012 and model.max() < 1e-3
    assert opened.max() < 0.010
    assert opened.max() < 2.0 * opened.mean(), "no jumps where the hand is shut"
    assert closed.mean() < 0.5 * opened.mean()
