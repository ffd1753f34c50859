"""A live twin records its run, and a replay without ROS repeats it to the bit."""

import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from builtin_interfaces.msg import Time as TimeMessage
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped, PoseStamped
from mcap.reader import make_reader
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.serialization import deserialize_message, serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger

from softrobot_twin.control.engagement import Activity
from softrobot_twin.errors import ParameterError
from softrobot_twin.record.replay import Replay
from softrobot_twin.record.run_file import CALL, TICK, RunFile
from softrobot_twin.record.tick_table import TickTable
from softrobot_twin.ros.device_node import DeviceNode
from softrobot_twin.ros.message_definitions import definition, type_name
from softrobot_twin.ros.target_node import TargetNode
from softrobot_twin.ros.topics import NODES

from .test_hostile_messages import begin, draw_seed, hostile_to, inputs, parameters  # noqa: F401

from test.places import ROOT

UNNUMBERED = {"publication_sequence_number": None, "source_timestamp": 0}
"""What rclpy tells of a message: by this, all are of one publisher."""


def set_gain(world, gain):
    value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=gain)
    request = SetParameters.Request(parameters=[ParameterMessage(name="correction_gain", value=value)])
    answer = world.ask(SetParameters, "/twin/set_parameters", request)
    assert answer.results[0].successful


def run_ticks(world, twin, count):
    """Runs until a twin has made so many more ticks, however busy the machine is."""
    before = twin.recording.recorder.ticks
    world.until(lambda: twin.recording.recorder.ticks >= before + count)


def is_following(twin):
    newest = twin.window.newest
    return newest is not None and newest.activity is Activity.FOLLOWING


@pytest.fixture
def live_run(world, make_twin, small_scene_file, tmp_path):
    """File of a run of twin, device and target in one world, and the twin's last tick."""
    path = tmp_path / "runs" / "run.mcap"
    twin = make_twin(record=str(path), use_device=True, closed_loop=True, deadline=0.004)
    scene = {"device_scene_file": str(small_scene_file), "scene_file": str(small_scene_file)}
    world.add(DeviceNode, **scene)
    world.add(TargetNode, **scene, target_radius=0.004, target_ramp_time=0.2)
    hostile = hostile_to(twin, draw_seed())
    # On a busy machine what was measured may be too old when the request comes.
    world.until(lambda: world.enable().success)
    world.until(lambda: is_following(twin))
    for number in range(30):
        for end in inputs(twin):
            end.callback(serialize_message(hostile.message(end.msg_type)), UNNUMBERED)
        if number == 10:
            set_gain(world, 3.5)
        run_ticks(world, twin, 2)
    assert world.ask(Trigger, "/twin/reset", Trigger.Request()).success
    run_ticks(world, twin, 5)
    twin.recording.close()
    return path, twin.recording.recorder


@pytest.mark.exhaustive
def test_a_live_run_with_device_targets_and_hostile_messages_is_replayed_to_the_bit(live_run):
    path, recorder = live_run
    run = RunFile(path)
    found = Replay(run).all_ticks()
    assert found.is_equal, found.first and found.first.in_words()
    assert run.is_complete and not run.lost and not recorder.failure
    assert found.ticks > 50 and found.calls > 100
    entries = list(run.entries())
    to = [entry.content["to"] for entry in entries if entry.kind == CALL]
    assert {"enable", "apply", "reset", "targets.accept_point", "device.accept", "markers.accept"} <= set(to)
    activities = {entry.content["values"]["activity"] for entry in entries if entry.kind == TICK}
    assert {"disabled", "following"} <= activities
    # A softer robot would have run otherwise.
    assert not Replay(run, changes=("body.material.young_modulus=153000.0",)).all_ticks().is_equal
    _check_topics(path, entries)


def _check_topics(path, entries):
    """Other tools read the topics of a file: what was published stands in the ticks too."""
    effectors, commands, kinds = [], [], {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            kinds[channel.topic] = schema.name, channel.message_encoding
            if channel.topic == "/twin/effectors/tip":
                heard = deserialize_message(message.data, PointStamped)
                effectors.append([heard.point.x, heard.point.y, heard.point.z])
            elif channel.topic == "/twin/cables":
                commands.append(list(deserialize_message(message.data, JointState).position))
            elif channel.topic == "/twin/record":
                json.loads(deserialize_message(message.data, String).data)
    assert kinds.pop("/twin/record")[0] == "std_msgs/msg/String"
    assert {encoding for _, encoding in kinds.values()} == {"cdr"}
    assert {"/diagnostics", "/twin/measured_cables", "/twin/markers", "/twin/target/tip",
            "/twin/cables"} <= kinds.keys()  # fmt: skip
    assert kinds["/twin/markers"][0] == "sensor_msgs/msg/PointCloud2"
    ticks = [entry.content["values"] for entry in entries if entry.kind == TICK]
    assert effectors == [values["effector_positions"][0] for values in ticks]
    assert commands == [values["command_setpoints"] for values in ticks
                        if "command_setpoints" in values]  # fmt: skip


@pytest.mark.sampled
@pytest.mark.parametrize("robot, changes", [
    ("air", {"mode": "direct"}), ("air", {"mode": "inverse"}), ("posed", {}),
])  # fmt: skip
def test_hostile_messages_of_every_kind_are_replayed_to_the_bit(
    world, parameters, tmp_path, robot, changes  # noqa: F811
):
    path = tmp_path / "run.mcap"
    twin = begin(world, parameters, robot, record=str(path), **changes)
    hostile = hostile_to(twin, draw_seed())
    for _ in range(25):
        for end in inputs(twin):
            for _ in range(4):
                end.callback(serialize_message(hostile.message(end.msg_type)), UNNUMBERED)
        twin.tick()
    twin.recording.close()
    again = Replay(RunFile(path))
    table, rows = TickTable(again.loop), []
    found = again.all_ticks(lambda outcome, _, time: rows.append(table.texts(outcome, 0, time)))
    assert found.is_equal, found.first and found.first.in_words()
    assert found.ticks == len(rows) == 25 and found.calls >= 25 * 4
    assert {len(row) for row in rows} == {len(table.header)}


def test_changes_of_the_scene_are_recorded_and_replayed_to_the_bit(
    world, make_twin, small_scene_file, tmp_path
):
    path = tmp_path / "run.mcap"
    changes = ["body.material.young_modulus=1.2e5", "cables.north.rate=0.02"]
    twin = make_twin(record=str(path), scene_changes=changes)
    assert twin.loop.simulation.scene.body.material.young_modulus == 1.2e5
    assert twin.loop.simulation.limits.rate[0] == 0.02
    run_ticks(world, twin, 10)
    twin.recording.close()
    run = RunFile(path)
    assert run.description.parameters["scene_changes"] == changes
    assert Replay(run).all_ticks().is_equal
    assert Replay(run, changes=("cables.north.rate=0.03",)).loop.simulation.limits.rate[0] == 0.03
    assert not Replay(run, small_scene_file).all_ticks().is_equal


def test_a_run_on_simulated_time_is_replayed_to_the_bit(world, make_twin, tmp_path):
    path = tmp_path / "run.mcap"
    twin = make_twin(use_sim_time=True, record=str(path), message_timeout=0.0)
    clock = world.probe.create_publisher(Clock, "/clock", 1)
    world.until(lambda: clock.get_subscription_count() == 1)
    targets = world.speaker(PointStamped, "/twin/target/tip")
    now, was_set_back = 1000.0, False
    deadline = time.monotonic() + 30.0
    while twin.tick_clock.ticks < 25:
        assert time.monotonic() < deadline
        now += 0.02
        if twin.tick_clock.ticks >= 15 and not was_set_back:
            now, was_set_back = now - 0.5, True
        seconds, rest = divmod(round(now * 1e9), 10**9)
        clock.publish(Clock(clock=TimeMessage(sec=seconds, nanosec=rest)))
        target = world.target_message((0.002, 0.0, 0.13))
        target.header.stamp = TimeMessage(sec=seconds, nanosec=rest)
        targets.publish(target)
        world.run(0.004)
    twin.recording.close()
    run = RunFile(path)
    found = Replay(run).all_ticks()
    assert found.is_equal and found.ticks >= 25
    assert run.description.parameters["use_sim_time"] is True
    assert any(call.content["answer"] is None for call in run.entries() if call.kind == CALL)
    times = [entry.content["ros_time"] for entry in run.entries() if entry.kind == TICK]
    assert max(times) < 2000 * 10**9 and times != sorted(times)


def test_diagnostics_tell_the_file_and_its_ticks(world, make_twin, diagnostics, tmp_path):
    path = tmp_path / "run.mcap"
    twin = make_twin(record=str(path))
    account = diagnostics("record")
    assert account.message == "recording" and account.values["file"] == str(path)
    assert int(account.values["ticks"]) > 0 and account.values["lost"] == "0"
    twin.recording.recorder.lost = 3
    assert diagnostics("record", lambda status: status.level == b"\x01").values["lost"] == "3"
    twin.recording.recorder.failure = "disk full"
    account = diagnostics("record", lambda status: status.level == b"\x02")
    assert "disk full" in account.message


@pytest.mark.parametrize("name, words", [
    ("run.rrd", "must end in .mcap"), ("taken.mcap", "exists already"),
    ("taken.mcap/run.mcap", "cannot be written"),
])  # fmt: skip
def test_a_file_that_cannot_be_written_is_refused_by_name(make_twin, tmp_path, name, words):
    (tmp_path / "taken.mcap").write_text("mine")
    with pytest.raises(ParameterError, match=words) as refused:
        make_twin(record=str(tmp_path / name))
    assert refused.value.name == "record" and str(tmp_path / name) in str(refused.value)
    assert (tmp_path / "taken.mcap").read_text() == "mine"


def test_without_mcap_the_package_to_install_is_named(make_twin, tmp_path, monkeypatch):
    monkeypatch.setattr("softrobot_twin.ros.run_recording.find_spec", lambda name: None)
    with pytest.raises(ParameterError, match="pip install mcap"):
        make_twin(record=str(tmp_path / "run.mcap"))


WITHOUT = """
import sys
sys.modules["mcap"] = None  # Its import fails.
import rclpy
from rclpy.parameter import Parameter
from softrobot_twin.ros.twin_node import TwinNode
rclpy.init()
given = {"scene_file": sys.argv[1], "mesh_error": False}
twin = TwinNode(parameter_overrides=[Parameter(name, value=value) for name, value in given.items()])
twin.tick()
assert twin.failed_ticks == 0, twin.failure
twin.destroy_node()
"""


@pytest.mark.exhaustive
def test_a_twin_that_records_nothing_runs_without_mcap(small_scene_file, ros_domain_id, monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", str(ros_domain_id))
    subprocess.run([sys.executable, "-c", WITHOUT, small_scene_file], cwd=ROOT, check=True, timeout=120)


# --- definitions ---------------------------------------------------------------------------------


KINDS = {topic.kind for topics in NODES.values() for topic in topics.values()
         if not isinstance(topic.kind, str)} | {Clock, DiagnosticArray, PoseStamped}  # fmt: skip


@pytest.mark.parametrize("kind", sorted(KINDS, key=type_name), ids=type_name)
def test_the_definition_of_a_message_has_the_fields_of_its_installed_file(kind):
    parts = re.split(r"=+\nMSG: (.+)\n", definition(kind))
    texts = {re.sub("/msg/", "/", type_name(kind)): parts[0],
             **dict(zip(parts[1::2], parts[2::2], strict=True))}  # fmt: skip
    for name, text in texts.items():
        package, word = name.split("/")
        file = Path(sys.prefix) / "share" / package / "msg" / f"{word}.msg"
        if not file.is_file():
            pytest.skip(f"{file} is not installed")
        assert [_words(line) for line in text.splitlines()] == _fields(file, package)


def _fields(file, package):
    """Type and name of each field of a message file, without comments, constants and defaults."""
    lines = [line.split("#")[0].split() for line in file.read_text().splitlines()]
    return [(_full(words[0], package), words[1]) for words in lines
            if len(words) > 1 and "=" not in " ".join(words[1:])]  # fmt: skip


def _words(line):
    kind, name = line.split()
    return kind.removesuffix("x"), name


def _full(kind, package):
    if kind.split("[")[0] in ("Header",):
        return f"std_msgs/{kind}"
    is_own = kind[0].isupper() and "/" not in kind
    return f"{package}/{kind}" if is_own else kind
