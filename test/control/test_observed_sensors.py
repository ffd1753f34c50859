"""Sensors in the observer: they tell hidden forces as markers do, and lead a robot no further where they lie."""

import numpy as np
import pytest
from numpy.linalg import norm

from softrobot_twin.analysis.marker_compliance import MarkerCompliance
from softrobot_twin.errors import CommandError, SceneError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.scripting.robot import Robot
from softrobot_twin.simulation import CommandSetpoints, Simulation, Touched

from .conftest import Driver, warmed_up
from .test_force_observer import TIP, force_of, hold, pose

RATE, NOISE, TARGET = 40.0, 1e-4, (0.008, 0.004, 0.134)
STRINGS = [{"name": "side", "string": [TIP, [0.0, 0.062, 0.025]], "noise": NOISE},
           {"name": "front", "string": [TIP, [0.062, 0.0, 0.025]], "noise": NOISE}]  # fmt: skip
OTHERS = [{"name": "rope", "cable": "north"},
          {"name": "bend", "bend": [[0.0, 0.0, 0.12], TIP, [0.0, 0.062, 0.025]], "axis": [1, 0, 0]}]


def scene(mapping, sensors, markers=0, **more):
    """The Diamond with these sensors, and so many of its markers."""
    effectors = [{key: value for key, value in one.items() if key != "measured_by"} for one in mapping["effectors"]]
    return scene_from_mapping({**mapping, "sensors": sensors, "effectors": effectors,
                               "markers": mapping["markers"][:markers], **more})  # fmt: skip


def observing(mapping, sensors, markers=0, **more):
    observer = {"forces": [{"name": "tip", "points": [TIP]}], **more}
    return warmed_up(Simulation(scene(mapping, sensors, markers, observer=observer)))


@pytest.fixture(scope="module")
def twins(small_scene_mapping):
    return {(sensors, markers): observing(small_scene_mapping, STRINGS[:sensors], markers)
            for sensors, markers in ((1, 0), (2, 0), (2, 1))}  # fmt: skip


@pytest.fixture(scope="module")
def real(small_scene_mapping):
    touch = {"name": "tip", "points": [TIP], "while_touched": "follow_targets"}
    return warmed_up(Simulation(scene(small_scene_mapping, STRINGS, 1, touches=[touch])))


@pytest.fixture
def rng(drawn_rng):
    return drawn_rng


def errors_of(twin, real, rng, force=(0.0, 0.0, 0.0), lie=lambda lengths: lengths, ticks=100, honest=0):
    """Errors of the tip from when a force acts and sensors lie, and from when they are honest again [m]."""
    twin.reset()
    real.reset()
    driver, sent, errors = Driver(twin, rate=RATE, use_device=True), real.rest_setpoints, []
    loop, none = driver.loop, np.full((1, 3), np.nan)
    settled, count = 40, len(twin.sensor_readings())
    for tick in range(settled + ticks + honest):
        is_on = settled <= tick < settled + ticks
        driver.measure(real.state.setpoints)
        told = real.sensor_readings()[:count] + rng.normal(0.0, NOISE, count)
        told = lie(told) if is_on else told
        for index, length in enumerate(told):
            loop.inputs["measured_sensor_lengths"].accept(index, ["length"], [length], [], driver.arrival())
        if len(twin.marker_ids) and np.isfinite(told).all():
            driver.see(real.marker_positions() + rng.normal(0.0, NOISE, (1, 3)))
        x, y, z = TARGET
        driver.target(x, -y if tick > settled + 20 else y, z)
        command = driver.tick().command
        if tick == 0:
            loop.enable(driver.time)
        real.step(CommandSetpoints(sent, 1.0 / RATE), None, Touched(np.array([force]) * is_on, none))
        sent = sent if command is None else np.array(command.setpoints)
        errors.append(norm(real.effector_positions()[0] - [x, -y if tick > settled + 20 else y, z]))
    return np.array(errors[settled : settled + ticks]), np.array(errors[settled + ticks :]), loop


def test_what_sensors_show_of_a_force_is_the_slope_of_their_values(small_scene_mapping, rng):
    twin = observing(small_scene_mapping, STRINGS[:1] + OTHERS, 3)
    setpoints = pose(twin, rng)
    hold(twin, setpoints, 80)
    compliance = MarkerCompliance(twin)
    by_loads, _, lag = compliance.at_state(np.zeros(1, int))
    assert np.abs(lag).max() < 1e-8
    rows, lengths, state, size = 3 * np.arange(3, 6), twin.model.sensors.lengths, twin.state, 1e-3
    assert by_loads.shape == (3 * (3 + 3 + 1), 3)
    for axis in range(3):
        seen = []
        for force in (size, -size):
            twin.restore(state)
            hold(twin, setpoints, 40, force_of(force * np.eye(3)[axis]))
            seen.append((twin.sensor_readings(), twin.effector_positions().ravel()))
        (more, ahead), (less, behind) = seen
        slopes, moved = (more - less) / (2.0 * size), (ahead - behind) / (2.0 * size)
        # Held at its end, a cable lengthens by no force, and the effector that no marker shows comes last.
        assert slopes == pytest.approx(by_loads[rows, axis] / lengths, abs=4e-3 * np.abs(slopes).max())
        assert moved == pytest.approx(by_loads[-3:, axis], abs=4e-3 * np.abs(by_loads[-3:, axis]).max())


@pytest.mark.parametrize("sensors, markers, share", [
    (1, 0, 0.8), pytest.param(2, 0, 0.8, marks=pytest.mark.exhaustive), (2, 1, 0.3)])
def test_a_hidden_force_along_a_string_is_borne_and_the_tip_comes_nearer(
        twins, real, rng, sensors, markers, share):  # fmt: skip
    force = np.array([0.0, 0.8, 0.0])
    errors, _, loop = errors_of(twins[sensors, markers], real, rng, force)
    blind, _, _ = errors_of(twins[sensors, markers], real, rng, force, lambda lengths: lengths + np.nan)
    assert errors[-20:].mean() < share * blind[-20:].mean()
    assert loop.observer.found.wrenches[0, 1] > 0.3


LIES = {
    "frozen": lambda kept: lambda lengths: kept.setdefault("x", lengths),
    "5 mm longer": lambda kept: lambda lengths: lengths + 5e-3,
    "half": lambda kept: lambda lengths: 0.5 * lengths,
    "broken": lambda kept: lambda lengths: lengths + 10.0,
    "noisy": lambda kept: lambda lengths: lengths + np.random.default_rng(int(1e9 * lengths[0])).normal(0, 0.02),
}


@pytest.fixture(scope="module")
def still(twins, real):
    """Errors where all sensors fall silent, by their number [m]."""
    return {sensors: errors_of(twin, real, np.random.default_rng(sensors), lie=lambda lengths: lengths + np.nan)[0]
            for (sensors, markers), twin in twins.items() if not markers}  # fmt: skip


@pytest.mark.parametrize("sensors", [1, pytest.param(2, marks=pytest.mark.exhaustive)])
@pytest.mark.parametrize("lie", LIES)
def test_sensors_that_lie_lead_a_robot_no_further_than_the_limit(twins, still, real, rng, sensors, lie):
    errors, after, loop = errors_of(twins[sensors, 0], real, rng, lie=LIES[lie]({}), honest=80)
    assert (errors - still[sensors]).max() < 1.2 * loop.settings.correction_limit + 4.0 * NOISE
    assert after[-10:].max() < 4.0 * NOISE


def test_forces_of_sensors_that_fall_silent_fade(twins, real, rng):
    _, _, loop = errors_of(twins[1, 0], real, rng, (0.0, 0.8, 0.0))
    assert loop.observer.found.is_any
    for tick in range(200):
        now = 10.0 + tick / RATE
        loop.tick(now, round((1000.0 + now) * 1e9))
    assert not loop.observer.found.is_any


def test_sensors_are_observed_in_python_and_odd_ones_are_refused(small_scene_mapping):
    robot = Robot(scene(small_scene_mapping, STRINGS[:1], observer={}))
    shown = robot.simulation.sensor_readings()[0]
    (force,) = robot.observe(sensors={"side_length_m": shown - 0.002}).values()
    assert np.isfinite(force.force).all() and norm(force.force) > 0.0
    for sensors in ({"nobody_m": 0.1}, {"side_length_m": np.nan}, {"side_length_m": np.inf}):
        with pytest.raises(CommandError):
            robot.observe(sensors=sensors)
    for change in ({"noise": -1e-4}, {"noise": 0.0}, {"noise": np.nan}):
        with pytest.raises(SceneError, match="noise"):
            scene(small_scene_mapping, [{**STRINGS[0], **change}], observer={})
    with pytest.raises(SceneError, match="three markers or more, or a sensor"):
        scene(small_scene_mapping, [], 2, observer={})
