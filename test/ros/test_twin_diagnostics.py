"""The twin's diagnostics, and parameters that change while it runs."""

import time
from dataclasses import replace

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PointStamped
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters

from softrobot_twin.simulation import Status

PARTS = {"loop", "solver", "limits", "markers", "device", "target", "view", "graph", "calibration"}
OK, WARN, ERROR = b"\x00", b"\x01", b"\x02"


def send_target(world, x, y, z):
    targets = world.speaker(PointStamped, "/twin/target/tip")
    targets.publish(world.target_message((x, y, z)))


def test_every_part_publishes_a_status_once_a_second(world, make_twin):
    make_twin()
    messages = world.hear(DiagnosticArray, "/diagnostics")
    world.until(lambda: len(messages) >= 3)
    stamps = [m.header.stamp.sec + 1e-9 * m.header.stamp.nanosec for m in messages]
    assert min(b - a for a, b in zip(stamps, stamps[1:], strict=False)) > 0.9
    newest = messages[-1]
    assert {status.name.removeprefix("twin: ") for status in newest.status} == PARTS
    assert {status.hardware_id for status in newest.status} == {"diamond"}


def test_the_statuses_have_the_documented_keys(world, make_twin, diagnostics):
    make_twin()
    send_target(world, 0.004, 0.0, 0.132)
    solver = diagnostics("solver", lambda s: s.values["activity"] == "following")
    assert {"status", "worst_status", "residual_n", "iterations", "nodes", "dof"} <= (solver.values.keys())
    counts = dict(word.split(":") for word in solver.values["statuses"].split())
    assert solver.values["status"] in counts and all(int(count) > 0 for count in counts.values())
    assert any(key.startswith("time_") for key in solver.values)
    assert float(solver.values["time_factor_ms"]) > 0.0
    loop = diagnostics("loop").values
    assert loop["rate_hz"] == "50"
    assert float(loop["compute_p50_ms"]) <= float(loop["compute_p99_ms"])
    assert float(loop["compute_p99_ms"]) <= float(loop["compute_max_ms"]) + 1e-9
    assert int(loop["ticks"]) > 0 and {"missed", "skipped", "period_ms"} <= loop.keys()
    target = diagnostics("target", lambda s: float(s.values["error_mm"]) < 0.1)
    assert target.level == OK and target.values["source"] == "point"
    markers = diagnostics("markers")
    assert markers.level == OK and markers.values["in_scene"] == "8"
    assert markers.values["visible"] == "0" and markers.message == "none visible"
    assert diagnostics("view").message == "off"
    assert diagnostics("device").message == "no device in use"


def test_saturation_is_a_warning_that_names_the_limits(world, make_twin, diagnostics):
    make_twin()
    send_target(world, 0.1, 0.0, 0.132)
    limits = diagnostics("limits", lambda status: status.level == WARN)
    assert "shortening" in limits.values["active"]
    solver = diagnostics("solver", lambda s: s.values["worst_status"] == "saturated")
    assert solver.level == WARN


def test_a_refused_target_gives_one_warning(world, make_twin, diagnostics):
    make_twin()
    send_target(world, float("nan"), 0.0, 0.132)
    target = diagnostics("target", lambda status: status.level == WARN)
    assert target.message == "1 messages refused"
    assert target.values["refused_not_finite"] == "1"
    later = diagnostics("target", lambda status: status.level == OK)
    assert later.values["refused"] == "1"


def test_a_target_that_times_out_is_a_warning(world, make_twin, diagnostics):
    make_twin(target_timeout=0.2)
    send_target(world, 0.0, 0.0, 0.132)
    target = diagnostics("target", lambda status: "timeout" in status.message)
    assert target.level == WARN and target.message.startswith("holding")


def test_a_failed_step_and_a_blocked_command_are_errors(world, make_twin, diagnostics, monkeypatch):
    twin = make_twin()
    honest = twin.loop.simulation.step
    monkeypatch.setattr(
        twin.loop.simulation, "step",
        lambda command, budget=None: replace(honest(command, budget), efforts=[float("nan")] * 4),
    )
    limits = diagnostics("limits", lambda status: status.level == ERROR)
    assert "north.not_finite" in limits.message and "kept back" in limits.message
    assert diagnostics("solver", lambda status: status.level == ERROR)


def test_an_overrun_is_skipped_reported_and_not_queued(world, make_twin, diagnostics, monkeypatch):
    """Hard case 38: every step takes five periods."""
    twin = make_twin(rate=50.0)
    honest, begun = twin.loop.tick, []

    def slow(*times):
        begun.append(time.monotonic())
        time.sleep(0.1)
        return honest(*times)

    monkeypatch.setattr(twin.loop, "tick", slow)
    loop = diagnostics("loop", lambda status: int(status.values["missed"]) > 3)
    assert loop.level == ERROR and "skipped" in loop.message
    assert twin.tick_clock.skipped >= 4 * (twin.tick_clock.missed - 1)
    monkeypatch.undo()
    # Nothing was queued: skipped ticks are not made up.
    world.run(0.2)
    before = twin.tick_clock.ticks
    world.run(1.0)
    assert twin.tick_clock.ticks - before <= 52


@pytest.fixture
def set_parameter(world):
    """Sets a parameter by the twin's service; returns the answer."""
    kinds = {
        bool: (ParameterType.PARAMETER_BOOL, "bool_value"),
        float: (ParameterType.PARAMETER_DOUBLE, "double_value"),
        str: (ParameterType.PARAMETER_STRING, "string_value"),
        list: (ParameterType.PARAMETER_DOUBLE_ARRAY, "double_array_value"),
    }

    def set_one(name, value):
        kind, field = kinds[type(value)]
        message = ParameterMessage(name=name, value=ParameterValue(type=kind, **{field: value}))
        request = SetParameters.Request(parameters=[message])
        return world.ask(SetParameters, "/twin/set_parameters", request).results[0]

    return set_one


def test_an_unknown_parameter_is_refused_by_its_name(make_twin, set_parameter):
    make_twin()
    for name, hint in (("ratte", "rate"), ("workspace.max", "workspace_max")):
        answer = set_parameter(name, 80.0)
        assert not answer.successful
        assert answer.reason == f"parameter {name} is unknown; did you mean {hint}?"


def test_settings_can_be_changed_while_the_twin_runs(make_twin, set_parameter):
    twin = make_twin()
    for name, value in (
        ("rate", 80.0), ("correction_gain", 3.0), ("closed_loop", True),
        ("on_lost_device", "open_loop"), ("workspace_max", [0.1, 0.2, 0.3]),
        ("target_timeout", 2.0),
    ):  # fmt: skip
        assert set_parameter(name, value).successful, name
        applied = getattr(twin.loop.settings, name)
        applied = list(applied) if isinstance(applied, tuple) else getattr(applied, "value", applied)
        assert applied == value, name


def test_an_invalid_setting_is_rejected_with_its_message(make_twin, set_parameter):
    twin = make_twin()
    before = twin.loop.settings
    for name, value, words in (
        ("workspace_min", [5.0, 5.0, 5.0], "must not be above workspace_max"),
        ("workspace_max", [5.0, 5.0], "three finite numbers"),
        ("on_lost_markers", "panic", "must be one of"), ("rate", -1.0, "range"),
        ("correction_gain", 1e9, "range"), ("rate", "fast", "type"),
        ("scene_file", "other.yaml", "read-only"), ("use_device", True, "read-only"),
    ):  # fmt: skip
        answer = set_parameter(name, value)
        assert not answer.successful and words in answer.reason.lower(), name
        assert twin.loop.settings == before, name


def test_a_new_rate_is_kept_from_the_next_tick_on(world, make_twin, set_parameter, diagnostics):
    twin = make_twin(rate=1.0)
    assert set_parameter("rate", 100.0).successful
    assert twin.loop.settings.period == twin.tick_clock.period == 0.01
    before = twin.tick_clock.ticks
    world.until(lambda: twin.tick_clock.ticks > before + 30, timeout=20.0)


def test_a_rate_that_is_changed_again_and_again_does_not_stop_the_ticks(world, make_twin, set_parameter):
    """A timer that restarts at every change never fires when changes are more frequent than
    ticks.
    """
    twin = make_twin(rate=1.0)  # A busy machine needs a tenth of a second for a change.
    before, began, changes = twin.tick_clock.ticks, time.monotonic(), 0
    while twin.tick_clock.ticks < before + 4:
        assert set_parameter("rate", 1.0 + 0.05 * (changes % 2)).successful
        changes += 1
        assert time.monotonic() - began < 60.0
    assert changes > 20
    assert twin.tick_clock.ticks - before <= 1.05 * (time.monotonic() - began) + 2.0
    assert set_parameter("rate", 0.1).successful
    assert set_parameter("rate", 50.0).successful
    # The next tick is due in a fiftieth of a second, not in ten.
    before = twin.tick_clock.ticks
    world.until(lambda: twin.tick_clock.ticks > before + 5, timeout=8.0)


@pytest.fixture
def impatient(monkeypatch):
    """Estimating processes have the lowest priority and might never run on a busy machine; not these."""
    from softrobot_twin.control import idle_process

    monkeypatch.setattr(idle_process, "PROGRAM", idle_process.PROGRAM.replace("{yields}", "False"))


@pytest.mark.exhaustive
def test_the_error_of_the_mesh_is_reported_once_it_is_estimated(world, make_twin, diagnostics, impatient):
    make_twin(mesh_error=True)
    world.until(lambda: diagnostics.messages, 30.0)
    solver = diagnostics(
        "solver", lambda s: float(s.values["discretization_error_mm"]) > 0.0, timeout=200.0
    ).values
    assert solver["mesh_error"] == "estimated"
    assert 0.0 < float(solver["mesh_error_at_lengths_percent"]) < 100.0
    assert float(solver["quadratic_error_at_forces_percent"]) < float(solver["mesh_error_at_forces_percent"])


@pytest.mark.exhaustive
def test_the_errors_of_a_reduced_body_are_reported(world, make_twin, diagnostics, impatient, half_trained):
    make_twin(scene_file=str(half_trained))
    world.until(lambda: diagnostics.messages, 60.0)
    solver = diagnostics("solver", lambda s: s.values["full_model"] == "compared", timeout=200.0).values
    assert 0.0 <= float(solver["body_sampled_range"]) < 1.0
    for key in ("body_reduction_error_mm", "body_full_model_error_mm"):
        assert 0.0 < float(solver[key]) < 5.0


LEVELS = {
    Status.OK: OK, Status.LINEARIZED: OK, Status.RATE_LIMITED: OK, Status.UNREACHABLE: WARN,
    Status.SATURATED: WARN, Status.NOT_CONVERGED: WARN, Status.INVERTED: WARN,
    Status.REFUSED: ERROR, Status.UNSOLVED: ERROR, Status.DIVERGED: ERROR,
}  # fmt: skip


def judged(twin, status=None, **report):
    """The parts of the diagnostics after a tick of a status, with changes of its report, by name."""
    outcome = twin.loop.tick(0.0, 0)
    result = replace(outcome.result, report=replace(outcome.result.report, **report))
    result = result if status is None else replace(result, status=status)
    twin.window.clear()
    twin.window.add(outcome._replace(result=result))
    return {part.name.split(": ")[-1]: part for part in twin.diagnostics.statuses(0.0)}


@pytest.mark.parametrize("status", Status)
def test_every_status_has_its_level_and_a_residual_above_the_tolerance_is_reported(make_twin, status):
    parts = judged(make_twin(), status, residual=0.0125, active_limits=("east.shortening_max",))
    solver, limits = parts["solver"], parts["limits"]
    assert solver.level == LEVELS[status]
    assert solver.message.startswith(status.value)
    told = status in (Status.LINEARIZED, Status.NOT_CONVERGED)
    assert ("0.013 N" in solver.message or "0.012 N" in solver.message) == told
    # An active limit is a separate warning when a more severe status hides it.
    grave = status is Status.SATURATED or LEVELS[status] == ERROR or status in (
        Status.NOT_CONVERGED, Status.INVERTED
    )  # fmt: skip
    assert limits.level == (WARN if grave else OK)
    assert "east.shortening_max" in limits.message


@pytest.mark.parametrize("late", [False, True])
def test_a_deadline_without_time_for_a_linearization_is_a_warning(make_twin, late):
    solver = judged(make_twin(), is_late=late, factor_age=0 if late else 3)["solver"]
    values = {value.key: value.value for value in solver.values}
    assert solver.level == DiagnosticStatus.WARN and "overload" in solver.message
    assert values["overloaded"] == "1" and values["late"] == str(int(late))
