"""Messages and levels of the diagnostics for states of the control loop."""

from typing import NamedTuple

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus

from softrobot_twin.analysis.reduction_error import BodyError
from softrobot_twin.control.arrival import Arrival
from softrobot_twin.control.diagnostics_window import DiagnosticsWindow
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.loop_timing import TickClock
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.ros.diagnostics import TwinDiagnostics
from softrobot_twin.scene import load_scene, scene_from_mapping
from softrobot_twin.simulation import Simulation

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@pytest.fixture(scope="module")
def diamond(small_scene_file):
    return Simulation.from_scene_file(small_scene_file)


class Watched:
    """A loop whose ticks a test calls, and its diagnostics."""

    def __init__(self, simulation, use_device=False, mode=Mode.INVERSE, **settings):
        simulation.reset()
        self.loop = TwinLoop(
            simulation, LoopSettings(rate=50.0, message_timeout=0.0, **settings),
            use_device=use_device, mode=mode,
        )  # fmt: skip
        self.clock, self.window = TickClock(0.02), DiagnosticsWindow()
        self.diagnostics = TwinDiagnostics(self.loop, self.clock, self.window, None)
        self.time = 0.0

    @property
    def arrival(self):
        return Arrival("base_link", 0, round(1e9 * (1000.0 + self.time)), self.time)

    def tick(self, count=1):
        for _ in range(count):
            self.time += 0.02
            outcome = self.loop.tick(self.time, round(1e9 * (1000.0 + self.time)))
            self.window.add(outcome)
        return outcome

    def account(self, part):
        """Level and message of a part; clears the window."""
        statuses = {status.name: status for status in self.diagnostics.statuses(self.time)}
        self.window.clear()
        found = statuses[f"twin: {part}"]
        return found.level, found.message


def test_a_rejected_marker_is_named_in_a_warning(diamond):
    watched = Watched(diamond)
    for _ in range(20):
        seen = watched.tick().predicted_markers
        watched.loop.markers.accept(diamond.marker_ids, seen, watched.arrival)
    watched.tick()
    assert watched.account("markers") == (OK, "visible")
    seen = seen + np.eye(8, 3, -5)
    watched.loop.markers.accept(diamond.marker_ids, seen, watched.arrival)
    watched.tick(3)
    level, message = watched.account("markers")
    assert level == WARN
    assert message == "left out as implausible: 5 (3 ticks), 6 (3 ticks), 7 (3 ticks)"


def test_a_target_outside_the_workspace_is_reported_once(diamond):
    watched = Watched(diamond)
    watched.loop.targets.accept_point(0, (9.0, 0.0, 0.13), watched.arrival)
    watched.tick()
    assert watched.account("target") == (WARN, "1 times limited to the workspace")
    watched.loop.targets.accept_point(0, (0.0, 0.0, 0.13), watched.arrival)
    watched.tick(40)
    watched.account("target")
    watched.tick()
    assert watched.account("target") == (OK, "following")


def test_the_device_of_another_robot_is_told_from_one_that_is_silent(diamond):
    watched = Watched(diamond, use_device=True)
    watched.tick()
    assert watched.account("device") == (WARN, "no message received")
    for _ in range(2):
        watched.loop.device.accept(("flexor", "extensor"), [0.1, 0.1], [], watched.arrival)
    assert watched.account("device") == (WARN, "no message accepted: 2 refused")
    done, why = watched.loop.enable(0.0)
    assert not done and why.endswith("to start from; messages refused so far: 2 wrong_names")


def test_impossible_lengths_are_reported_with_actuator_value_and_limits(diamond):
    watched = Watched(diamond, use_device=True)
    names = diamond.actuator_names
    watched.loop.device.accept(names, diamond.rest_setpoints, [], watched.arrival)
    watched.loop.enable(watched.time)
    watched.tick(3)
    watched.loop.device.accept(names, np.full(4, 1e6), [], watched.arrival)
    watched.tick()
    level, message = watched.account("device")
    assert level == WARN and message.startswith("north measures 1e+06 m, accepted are 0.0")
    watched.tick(50)
    level, message = watched.account("device")
    assert level == ERROR and "device lost, north measures 1e+06 m" in message


@pytest.mark.parametrize("late, cause", [(0, "rate limit: "), (5, "late: 5 of 6 ticks")])
def test_a_large_tracking_error_is_a_warning_with_its_cause(diamond, late, cause):
    watched = Watched(diamond)
    watched.tick()
    watched.account("target")
    watched.loop.targets.accept_point(0, (0.02, 0.0, 0.134), watched.arrival)
    watched.tick()
    watched.clock.skipped += late
    level, message = watched.account("target")
    assert level == WARN and f" mm: {cause}" in message
    watched.tick(60)
    watched.account("target")
    watched.tick()
    assert watched.account("target") == (OK, "following")


class Judged(NamedTuple):
    """What a `ReductionErrorWatch` has received."""

    newest: dict
    states: dict = {}
    answers: int = 1
    cause: str = ""


def test_a_reduced_body_far_from_the_full_model_or_outside_its_range_is_a_warning(half_trained):
    watched = Watched(Simulation(load_scene(half_trained), with_warnings=False))
    watched.loop.targets.accept_point(0, (0.004, 0.0, 0.128), watched.arrival)
    watched.tick(60)
    diagnostics = watched.diagnostics
    diagnostics.reduction = Judged({"body": BodyError(1.0e-5, 0.002)})
    assert watched.account("solver")[0] == OK
    watched.tick()
    diagnostics.reduction = Judged({"body": BodyError(2.0e-3, 0.31)})
    assert watched.account("solver") == (WARN, "body: 2 mm (31 % of the displacement) from the full model")
    for _ in range(150):
        watched.loop.targets.accept_point(0, (0.030, 0.0, 0.115), watched.arrival)
        watched.tick()
    level, message = watched.account("solver")
    assert level == WARN
    assert message == (
        "saturated; body: outside of the range of its reduction; "
        "body: 2 mm (31 % of the displacement) from the full model"
    )


@pytest.mark.parametrize("pull", [0.5, 0.9])
def test_a_pair_near_slipping_is_named_in_a_warning_with_what_friction_it_has_left(pull):
    watched = Watched(Simulation(scene_from_mapping(dict(
        name="block", gravity=[0.7 * pull * 9.81, 0.0, -9.81], integration="dynamic",
        obstacles=[{"name": "floor", "plane": {}}],
        contact={"friction": 0.7, "between": [{"pair": ["box", "floor"], "least_grip_margin": 0.2}]},
        rigid_bodies=[{"name": "box", "mass": 0.03, "position": [0, 0, 0.02],
                       "box": {"size": [0.04] * 3}}],
    ))), mode=Mode.DIRECT)  # fmt: skip
    watched.tick(5)
    statuses = {status.name: status for status in watched.diagnostics.statuses(watched.time)}
    values = {value.key: value.value for value in statuses["twin: contact"].values}
    assert float(values["grip_margin: on box by floor"]) == pytest.approx(1.0 - pull, abs=1e-5)
    is_near = pull > 0.8
    expected = (WARN, "near slipping: box.floor") if is_near else (OK, "contacts: 4")
    assert watched.account("contact") == expected
