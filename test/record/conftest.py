"""A run of the Diamond on its coarsest mesh, with a device, recorded without ROS."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.loop_settings import LoopSettings
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.record.run_clock import RecordedClock
from softrobot_twin.record.run_description import describe
from softrobot_twin.record.run_file import Topic
from softrobot_twin.record.run_recorder import RunRecorder
from softrobot_twin.scene.loading import load_scene, read_yaml, written_out
from softrobot_twin.simulation import Simulation
from test.places import ROOT
from test.scene_changes import yaml_file

MESH = ROOT / "meshes/diamond_200.vtk"
START = 1_000 * NANOSECONDS
TICKS = 30
RATE = 20.0
PARAMETERS = {
    "mode": "inverse", "use_device": True, "velocity_effector": "", "frame_id": "base_link",
    "ambient_pressure": 101325.0,
}  # fmt: skip
TIP = (0.004, 0.002, 0.128)
TOPIC = Topic("/twin/effectors/tip", "test/msg/Text", "string data\n", "out")


class Live:
    """A loop whose run is recorded, on a clock of its own."""

    def __init__(self, scene, path, **options):
        clock = RecordedClock()
        simulation = Simulation(load_scene(scene), clock)
        settings = LoopSettings(rate=RATE, **options.pop("settings", {}))
        self.loop = TwinLoop(simulation, settings, use_device=True)
        simulation.warm_up()
        self.time, self.outcomes = 5.0, []
        description = describe(self.loop, "/twin", START, PARAMETERS)
        self.recorder = RunRecorder(
            path, self.loop, clock, description, lambda: self.ros_time, str.encode, **options
        )

    @property
    def ros_time(self):
        return START + round(self.time * NANOSECONDS)

    def arrival(self, age=0.0, frame_id="base_link"):
        return Arrival(frame_id, self.ros_time - round(age * NANOSECONDS), self.ros_time, self.time)

    def measure(self, lengths):
        names = list(self.loop.simulation.actuator_names)
        return self.loop.device.accept(names, list(lengths), [], self.arrival())

    def tick(self):
        """A tick; the device is then where it was sent, and it measures its markers."""
        outcome = self.loop.tick(self.time, self.ros_time)
        self.recorder.note_message(TOPIC, f"tick {len(self.outcomes)}")
        self.recorder.pass_on()
        self.outcomes.append(outcome)
        if outcome.command is not None:
            self.measure(outcome.command.setpoints)
        elif not self.loop.is_enabled:
            self.measure(self.loop.simulation.rest_setpoints)
        else:
            self.measure(self.loop.device.setpoints)
        self.loop.markers.accept(
            self.loop.simulation.marker_ids, outcome.predicted_markers + 1e-4, self.arrival()
        )
        self.time += 1.0 / RATE
        return outcome


def drive(live, ticks=TICKS):
    """Targets, velocities, refused messages, changed settings, and the three services."""
    loop = live.loop
    for number in range(ticks):
        if number == 2:
            assert loop.enable(live.time)[0]
        if number == 4:
            assert loop.targets.accept_point(0, TIP, live.arrival()) is None
        if number == 7:
            refused = [
                loop.targets.accept_point(0, (math.nan, 0.0, math.inf), live.arrival()),
                loop.targets.accept_point(0, (0.0, -0.0), live.arrival()),
                loop.targets.accept_point(0, TIP, live.arrival(age=30.0)),
                loop.targets.accept_point(0, TIP, live.arrival(frame_id="\0é\udce9")),
                loop.device.accept(["strange"] * 3, [math.inf], [], live.arrival()),
                loop.markers.accept(np.array([4, 4], np.uint32), np.zeros((2, 3)), live.arrival()),
                loop.targets.accept_velocity((math.inf, 0.0, 0.0), live.time),
            ]
            assert None not in refused
            assert loop.markers.accept(np.empty(0, np.uint32), np.empty((0, 3)), live.arrival()) is None
        if number == 10:
            assert loop.targets.accept_velocity((1e308, -0.0, 0.001), live.time) is None
        if number == 14:
            loop.apply(LoopSettings(rate=RATE, closed_loop=True, correction_gain=3.0))
        if number == 18:
            # One actuator is commanded, the others follow.
            names = [str(loop.simulation.actuator_names[1])]
            length = [float(loop.simulation.state.setpoints[1])]
            assert loop.selected.accept(names, length, [], live.arrival()) is None
        if number == 22:
            loop.disable()
        if number == 24:
            loop.reset()
        live.tick()


class Recorded(NamedTuple):
    """A recorded run.

    Attributes:
        scene: Its scene.
        path: Its file.
        outcomes: What its ticks gave.
    """

    scene: Path
    path: Path
    outcomes: list


@pytest.fixture(scope="session")
def scene_file(tmp_path_factory):
    mapping = written_out(read_yaml((ROOT / "config/scenes/diamond.yaml").read_text()))
    folder = tmp_path_factory.mktemp("scenes")
    (folder / "mesh.vtk").write_bytes(MESH.read_bytes())
    mapping["body"]["mesh"]["file"] = "mesh.vtk"
    mapping["body"]["element"] = "linear"
    return yaml_file(folder / "diamond.yaml", mapping)


@pytest.fixture(scope="session")
def recorded(scene_file, tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "run.mcap"
    live = Live(scene_file, path)
    drive(live)
    live.recorder.close()
    assert not live.recorder.failure
    return Recorded(scene_file, path, live.outcomes)
