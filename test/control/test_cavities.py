"""Cavities in the loop: pressures in messages of their own, beside all actuators in one."""


import numpy as np
import pytest

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.control.engagement import Activity
from softrobot_twin.control.loop_settings import LoopSettings, Mode
from softrobot_twin.control.simulated_device import DeviceFlaws, SimulatedDevice
from softrobot_twin.control.twin_loop import TwinLoop
from softrobot_twin.errors import ParameterError, SceneError
from softrobot_twin.scene import scene_from_mapping
from softrobot_twin.simulation import CommandSetpoints, Simulation, Status

AIR = 101325.0
NAMES = ("east", "low", "high", "syringe")
REST = (0.1, 0.0, 0.0, 2e-6)
LOW, HIGH, SYRINGE = 1, 2, 3
RATES = {LOW: 2e4, HIGH: 1e4, SYRINGE: 1e-6}
STEP = 0.02


# --- commands ------------------------------------------------------------------------------------


def test_a_pressure_commands_one_cavity_and_the_others_stay(drive_air):
    driver = drive_air(mode=Mode.DIRECT)
    assert driver.press("low", AIR + 2000.0) is None
    assert driver.tick(10).activity is Activity.COMMANDED
    assert driver.commands[-1] == pytest.approx([0.1, 2000.0, 0.0, 2e-6], abs=1e-9)
    assert driver.press("high", AIR - 1000.0) is None
    driver.tick(10)
    assert driver.commands[-1] == pytest.approx([0.1, 2000.0, -1000.0, 2e-6], abs=1e-9)


def test_a_message_to_all_and_pressures_command_beside_each_other(drive_air):
    driver = drive_air(mode=Mode.DIRECT)
    driver.press("low", AIR + 2000.0)
    # It omits both pressures: one was given, the other was not.
    assert driver.wind(("syringe", "east"), [2.1e-6, 0.099]) is None
    driver.tick(10)
    assert driver.commands[-1] == pytest.approx([0.099, 2000.0, 0.0, 2.1e-6], abs=1e-9)
    # It names all: the newest message counts.
    assert driver.wind(NAMES, [0.1, 500.0, 300.0, 2e-6]) is None
    driver.tick(10)
    assert driver.commands[-1] == pytest.approx([0.1, 500.0, 300.0, 2e-6], abs=1e-9)
    driver.press("high", AIR + 100.0)
    driver.tick(10)
    assert driver.commands[-1] == pytest.approx([0.1, 500.0, 100.0, 2e-6], abs=1e-9)


def test_actuators_that_no_message_names_hold(drive_air):
    driver = drive_air(mode=Mode.DIRECT)
    assert driver.wind(("east", "low"), [0.099, 0.0]) is None
    assert driver.wind(("syringe",), [2.1e-6]) is None
    driver.tick(10)
    assert driver.commands[-1] == pytest.approx([0.099, 0.0, 0.0, 2.1e-6], abs=1e-9)
    assert driver.wind(("nobody",), [0.1]) is Refusal.WRONG_NAMES


def test_a_pressure_joins_commanded_efforts(drive_air):
    """Efforts of all, then the pressure of one: tension and volume's pressure stay efforts."""
    driver = drive_air(mode=Mode.DIRECT)
    assert driver.wind(("east", "syringe"), [], [0.2, 300.0]) is None
    driver.press("low", AIR + 1000.0)
    outcome = driver.tick(20)
    efforts = outcome.command.efforts
    assert efforts[[LOW, HIGH]] == pytest.approx([1000.0, 0.0], abs=1e-3)
    assert efforts[[0, SYRINGE]] == pytest.approx([0.2, 300.0], rel=1e-3)


def test_a_pressure_commands_a_cavity_beside_targets(drive_air):
    driver = drive_air()
    driver.target(0.01, 0.01, 0.1005)
    driver.press("high", AIR + 3000.0)
    outcome = driver.tick(40)
    assert outcome.activity is Activity.FOLLOWING
    assert outcome.command.setpoints[HIGH] == pytest.approx(3000.0, abs=1e-6)
    assert outcome.tracking_errors[0] < 1e-5
    # A message to other actuators leaves it commanded; one that names it, or none, does not.
    driver.choose(("east",), [0.1])
    assert driver.loop.selected.setpoints[HIGH] == 3000.0
    driver.choose(("high",), [2000.0])
    driver.choose(("east",), [0.1])
    assert np.isnan(driver.loop.selected.setpoints[HIGH])
    driver.press("high", AIR + 1000.0)
    driver.choose((), [])
    assert driver.loop.selected.setpoints is None
    driver.press("low", AIR + 1000.0)
    assert np.isnan(driver.loop.selected.setpoints[[0, HIGH, SYRINGE]]).all()


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("name, pressure, header, refusal", [
    ("low", np.nan, {}, Refusal.NOT_FINITE),
    ("low", np.inf, {}, Refusal.NOT_FINITE),
    ("low", -np.inf, {}, Refusal.NOT_FINITE),
    ("low", -1000.0, {}, Refusal.BELOW_VACUUM),
    ("low", 0.0, {}, Refusal.BELOW_VACUUM),
    ("low", AIR + 1e3, {"age": 2.0}, Refusal.STALE),
    ("low", AIR + 1e3, {"age": -2.0}, Refusal.FROM_THE_FUTURE),
    ("low", AIR + 1e3, {"age": 0.1}, Refusal.OUT_OF_ORDER),
    ("low", AIR + 1e3, {"frame_id": "map"}, Refusal.WRONG_FRAME),
    ("middle", AIR + 1e3, {}, Refusal.WRONG_NAMES),
    ("east", AIR + 1e3, {}, Refusal.WRONG_NAMES),
    ("syringe", AIR + 1e3, {}, Refusal.VOLUME_CONTROLLED),
])  # fmt: skip
def test_an_invalid_pressure_is_refused_and_changes_nothing(
    drive_air, mode, name, pressure, header, refusal
):
    driver = drive_air(mode=mode)
    assert driver.press("low", AIR + 700.0) is None
    kept = driver.loop.direct if mode is Mode.DIRECT else driver.loop.selected
    before = kept.setpoints.copy()
    assert driver.press(name, pressure, **header) is refusal
    assert np.array_equal(kept.setpoints, before, equal_nan=True)
    assert kept.refusals.by_word() == {refusal.value: 1}
    assert driver.press("low", AIR + 800.0) is None
    assert kept.setpoints[LOW] == pytest.approx(800.0)


def test_a_pressure_beyond_the_limits_stops_at_the_limit_and_is_named(drive_air):
    driver = drive_air(mode=Mode.DIRECT)
    # A gauge pressure that was sent by mistake asks for a deep vacuum.
    driver.press("high", 2000.0)
    outcome = driver.tick(40)
    assert outcome.command.setpoints[HIGH] == pytest.approx(-5000.0)
    assert outcome.result.status is Status.SATURATED
    assert "high.pressure_min" in outcome.result.report.active_limits


def test_a_reset_forgets_pressures_and_the_order_of_their_stamps(drive_air):
    driver = drive_air(mode=Mode.DIRECT)
    driver.press("low", AIR + 1000.0)
    driver.tick(5)
    driver.loop.reset()
    assert driver.loop.direct.setpoints is None
    assert driver.press("low", AIR + 500.0, age=0.15) is None
    driver.tick(10)
    driver.wind(("east", "syringe"), [0.1, 2e-6])
    assert driver.loop.direct.setpoints[LOW] == pytest.approx(500.0)


# --- absolute and gauge --------------------------------------------------------------------------


def test_messages_are_absolute_at_any_ambient_pressure(drive_air):
    driver = drive_air(mode=Mode.DIRECT, ambient_pressure=70e3)
    driver.press("low", 71e3)
    outcome = driver.tick(10)
    assert outcome.command.setpoints[LOW] == pytest.approx(1000.0)
    absolute = driver.loop.cavities.absolute(outcome.command.efforts)
    assert list(absolute) == ["low", "high", "syringe"]
    assert absolute["low"] == pytest.approx(71e3) and absolute["high"] == pytest.approx(70e3)
    # The pressure of a cavity that is commanded by volume is the model's.
    assert absolute["syringe"] == 70e3 + outcome.result.efforts[SYRINGE]


@pytest.mark.parametrize("ambient", [0.0, -1.0, np.nan, np.inf, 4000.0])
def test_an_ambient_pressure_that_cannot_be_is_refused(drive_air, ambient):
    with pytest.raises(ParameterError) as raised:
        drive_air(ambient_pressure=ambient)
    assert raised.value.name == "ambient_pressure"


def test_a_limit_below_vacuum_is_refused_by_cavity(air_scene):
    scene = {**air_scene, "cavities": [dict(entry) for entry in air_scene["cavities"]]}
    scene["cavities"][1]["pressure"] = [-2e5, 1e4]
    simulation = Simulation(scene_from_mapping(scene))
    with pytest.raises(ParameterError, match="cavity high may be evacuated to -200000 Pa gauge"):
        TwinLoop(simulation, LoopSettings())


@pytest.fixture
def sealed_scene(air_scene):
    """The block with its middle cavity sealed, at an ambient pressure of 90 kPa."""
    low, high, syringe = air_scene["cavities"]
    return {
        **air_scene, "cavities": [low, syringe],
        "sealed_cavities": [{"name": "gas", "walls": high["walls"], "pressure": 500.0,
                             "ambient_pressure": 9e4}],
    }  # fmt: skip


def test_the_pressure_of_sealed_gas_is_absolute_and_its_ambient_pressure_is_compared(sealed_scene):
    simulation = Simulation(scene_from_mapping(sealed_scene))
    cavities = TwinLoop(simulation, LoopSettings(), Mode.DIRECT, ambient_pressure=9e4).cavities
    assert cavities.sealed(simulation.state.positions) == pytest.approx({"gas": 90500.0})
    assert cavities.names == ("low", "syringe") and cavities.notes == ()
    result = simulation.step(CommandSetpoints(simulation.rest_setpoints - [0.005, 0, 0], 1.0))
    # The bent block gives the gas a little more room.
    assert 90400.0 < cavities.sealed(result.state.positions)["gas"] < 90490.0
    notes = TwinLoop(simulation, LoopSettings(), Mode.DIRECT).cavities.notes
    assert notes == ("sealed_cavities[0].ambient_pressure = 90000 Pa is not the ambient_pressure "
                     "of the twin, 101325 Pa",)  # fmt: skip


def test_a_sealed_cavity_needs_a_name_of_its_own(sealed_scene):
    sealed_scene["sealed_cavities"][0]["name"] = "low"
    simulation = Simulation(scene_from_mapping(sealed_scene))
    with pytest.raises(SceneError, match="is a cavity's name too"):
        TwinLoop(simulation, LoopSettings(), Mode.DIRECT)


# --- rates, in any state -------------------------------------------------------------------------


def steps_of(driver, start=REST):
    """Changes of setpoints from command to command, the first from a start."""
    return np.abs(np.diff(np.vstack([start, driver.commands]), axis=0))


def assert_rates_kept(driver, start=REST):
    steps = steps_of(driver, start)
    for index, rate in RATES.items():
        assert steps[:, index].max() <= rate * STEP * (1.0 + 1e-9)


@pytest.mark.parametrize("mode", list(Mode))
def test_no_service_call_moves_a_pressure_faster_than_its_rate(drive_air, mode):
    driver = drive_air(mode=mode)
    if mode is Mode.INVERSE:
        driver.target(0.01, 0.01, 0.1008)
    driver.press("low", AIR + 15e3)
    driver.press("high", AIR + 8e3)
    driver.tick(20)
    driver.loop.disable()
    assert driver.tick(3).command is None
    driver.loop.enable(driver.time)
    driver.press("low", AIR + 1e3)
    driver.press("high", AIR - 4e3)
    driver.tick(10)
    driver.loop.reset()
    assert driver.tick(2).activity is Activity.RETURNING
    driver.press("high", AIR + 9e3)
    driver.tick(2)
    driver.loop.disable()
    driver.tick()
    driver.loop.reset()
    driver.loop.enable(driver.time)
    while driver.tick().activity is Activity.RETURNING:
        assert len(driver.outcomes) < 300
    assert driver.commands[-2] == pytest.approx(REST, abs=1.0)
    assert_rates_kept(driver)
    assert steps_of(driver)[:, LOW].max() == pytest.approx(RATES[LOW] * STEP)


# --- a device ------------------------------------------------------------------------------------


def measure(driver, low=0.0, high=0.0, **header):
    """Cable and volume in one message, each pressure in a message of its own."""
    loop = driver.loop
    assert loop.device.accept(
        ("syringe", "east"), [2e-6, 0.1], [300.0, 0.0], driver.arrival(**header)
    ) is None
    refused = driver.sense("low", AIR + low, **header)
    return refused or driver.sense("high", AIR + high, **header)


def test_measurements_are_put_together_from_all_messages(drive_air):
    driver = drive_air(use_device=True, mode=Mode.DIRECT)
    loop = driver.loop
    assert driver.sense("low", AIR + 3000.0, frame_id="sensor_3") is None
    assert driver.sense("high", AIR - 5.0) is None
    done, why = loop.enable(driver.time)
    assert not done and why == "no measured setpoints of east, syringe arrive to start from"
    assert measure(driver, 3000.0, -5.0) is None
    assert loop.device.setpoints == pytest.approx([0.1, 3000.0, -5.0, 2e-6])
    # A sensor of a cavity that is commanded by volume measures an effort.
    assert driver.sense("syringe", AIR + 400.0) is None
    assert loop.device.efforts[SYRINGE] == pytest.approx(400.0)
    assert loop.device.setpoints[SYRINGE] == 2e-6
    assert loop.enable(driver.time)[0]
    start = loop.device.setpoints.copy()
    while driver.tick().command is None:
        measure(driver, 3000.0, -5.0)
        assert len(driver.outcomes) < 50
    assert driver.commands[0] == pytest.approx(start, abs=1.5)
    driver.press("low", AIR + 1e3)
    measure(driver, 3000.0, -5.0)
    driver.tick(3)
    assert_rates_kept(driver, start)


def test_a_device_is_lost_when_one_pressure_is_no_longer_measured(drive_air):
    driver = drive_air(use_device=True, mode=Mode.DIRECT, device_timeout=0.2)
    measure(driver)
    driver.loop.enable(driver.time)
    for _ in range(5):
        measure(driver)
        driver.tick()
    assert not driver.loop.device_is_lost(driver.time)
    for _ in range(12):
        driver.loop.device.accept(("syringe", "east"), [2e-6, 0.1], [], driver.arrival())
        driver.sense("high", AIR)
        driver.tick()
    assert driver.loop.device_is_lost(driver.time)
    assert driver.loop.unheard(driver.time) == "low"


def test_an_implausible_pressure_is_refused_and_named_in_gauge_pascals(drive_air):
    driver = drive_air(use_device=True, mode=Mode.DIRECT)
    measure(driver)
    assert driver.sense("low", 3000.0) is Refusal.OUT_OF_RANGE
    assert driver.sense("high", AIR) is None
    done, why = driver.loop.enable(driver.time)
    assert not done and why.startswith(
        "low measures -98325 Pa (gauge), accepted are -2000 to 22000 Pa (gauge)"
    )
    assert driver.sense("low", -1.0) is Refusal.BELOW_VACUUM
    assert driver.sense("low", AIR + 1.0) is None
    assert driver.loop.device.implausible is None
    assert driver.loop.enable(driver.time)[0]
    # A later message to all clears it too.
    driver.sense("low", 3000.0)
    driver.loop.device.accept(NAMES, [0.1, 5.0, 0.0, 2e-6], [], driver.arrival())
    assert driver.loop.device.implausible is None


def test_a_pressure_without_limits_may_be_measured_slightly_below_zero(air_scene):
    scene = {**air_scene, "cavities": [dict(entry) for entry in air_scene["cavities"]]}
    del scene["cavities"][0]["pressure"]
    simulation = Simulation(scene_from_mapping(scene))
    loop = TwinLoop(simulation, LoopSettings(), Mode.DIRECT, use_device=True)
    assert loop.device.put(np.array([LOW]), -20.0, 0.0) is None
    assert loop.device.put(np.array([LOW]), -1e5, 0.0) is Refusal.OUT_OF_RANGE


def follow_through_valves(driver, device, height, seconds):
    """Ticks of a twin and its device in turn, after the twin was enabled."""
    loop = driver.loop
    for _ in range(round(seconds / STEP)):
        reading = device.read(driver.time)
        arrival = driver.arrival()
        loop.device.accept(device.actuator_names, reading.setpoints, reading.efforts, arrival)
        for name in device.cavity_names:
            index = device.actuator_names.index(name)
            driver.sense(name, AIR + float(reading.efforts[index]))
        driver.see(reading.marker_positions, reading.marker_ids)
        if not loop.is_enabled:
            assert loop.enable(driver.time)[0]
        driver.target(0.01, 0.01, height)
        outcome = driver.tick()
        if outcome.command is not None:
            device.apply(outcome.command.setpoints, driver.time)


@pytest.fixture(scope="module")
def _built_stiffer_air(air_scene):
    scene = {**air_scene, "body": {**air_scene["body"]}}
    scene["body"]["material"] = {**scene["body"]["material"], "young_modulus": 1.2e5}
    simulation = Simulation(scene_from_mapping(scene))
    simulation.warm_up()
    return simulation


@pytest.mark.exhaustive
def test_the_loop_closes_over_valves_with_lag_limited_flow_and_noise(drive_air, _built_stiffer_air):
    flaws = DeviceFlaws(delay=0.02, marker_noise=1e-6, seed=1, valve_lag=0.1, flow_limit=1e-5,
                        pressure_noise=20.0)  # fmt: skip
    device = SimulatedDevice(_built_stiffer_air, flaws)
    driver = drive_air(use_device=True, closed_loop=True)
    follow_through_valves(driver, device, 0.1006, 6.0)
    error = abs(device.read(driver.time).effector_positions[0, 2] - 0.1006)
    assert error < 2e-5
    # The twin never took lag or noise for a device that is somewhere else.
    activities = [outcome.activity for outcome in driver.outcomes]
    assert Activity.RESYNCHRONISING not in activities[10:]
    assert driver.loop.device.refusals.total == 0
    start = driver.commands[0]
    assert_rates_kept(driver, start)
