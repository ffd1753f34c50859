"""The nodes as processes, from ``ros2 run`` to Ctrl-C."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from softrobot_twin.ros.parameters import DEVICE, TARGET, TWIN

ROOT = Path(__file__).resolve().parents[2]
NODES = ("twin", "device", "target")


@pytest.fixture
def start(ros_domain_id, small_scene_file, tmp_path):
    """Starts a node; its output goes to a file."""
    started = []

    def begin(node, **parameters):
        values = {"scene_file": small_scene_file, "device_scene_file": small_scene_file,
                  **parameters}
        command = [sys.executable, "-m", "softrobot_twin.ros.process", node, "--ros-args"]
        for name, value in values.items():
            command += ["-p", f"{name}:={value}"]
        output = tmp_path / f"{node}.log"
        environment = {**os.environ, "ROS_DOMAIN_ID": str(ros_domain_id), "PYTHONPATH": str(ROOT)}
        with output.open("wb") as file:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT,
                env=environment, start_new_session=True,
            )
        started.append(process)
        return process, output

    yield begin
    for process in started:
        if process.poll() is None:
            process.kill()
            process.wait()


def wait_for(word, process, output):
    deadline = time.monotonic() + 60.0
    while word not in output.read_text():
        assert process.poll() is None, output.read_text()
        assert time.monotonic() < deadline, output.read_text()
        time.sleep(0.05)


@pytest.mark.parametrize("node", NODES)
def test_an_interrupt_ends_a_node_cleanly(start, node):
    process, output = start(node)
    wait_for("ready", process, output)
    # The terminal and ros2 run both send one.
    process.send_signal(signal.SIGINT)
    process.send_signal(signal.SIGINT)
    assert process.wait(20.0) == 0
    assert "Traceback" not in output.read_text()


def test_a_termination_request_ends_a_node_cleanly(start):
    process, output = start("target")
    wait_for("ready", process, output)
    process.send_signal(signal.SIGTERM)
    assert process.wait(20.0) == 0
    assert "Traceback" not in output.read_text()


@pytest.mark.parametrize(
    ("node", "parameters", "words"),
    [
        ("twin", {"scene_file": "/nowhere.yaml"}, "parameter scene_file = '/nowhere.yaml'"),
        ("twin", {"rate": "30"}, "parameter rate"),
        ("device", {"device_scene_file": "/nowhere.yaml"}, "parameter device_scene_file"),
        ("target", {"target_path": "spiral"}, "parameter target_path = 'spiral'"),
    ],
)
def test_an_impossible_setting_ends_a_node_with_one_line_and_exit_code_2(
    start, node, parameters, words
):
    process, output = start(node, **parameters)
    assert process.wait(60.0) == 2
    told = [line for line in output.read_text().splitlines() if line.startswith(f"{node}: ")]
    assert len(told) == 1 and words in told[0]
    assert "Traceback" not in output.read_text()


def test_an_unknown_parameter_is_reported(start):
    process, output = start("target", traget_radius="0.01")
    wait_for("ready", process, output)
    assert "parameter traget_radius is unknown and ignored" in output.read_text()
    # Parameters of the other nodes are known, because all nodes share one file.
    assert "scene_file is unknown" not in output.read_text()


def run(node, *arguments):
    """Runs a node that ends by itself: because of an error, or after printing its help."""
    return subprocess.run(
        [sys.executable, "-m", "softrobot_twin.ros.process", node, *arguments], cwd=ROOT,
        capture_output=True, text=True, timeout=100, check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip


@pytest.fixture
def broken_file(tmp_path):
    file = tmp_path / "broken.yaml"
    file.write_text("/**: [")
    return str(file)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--params-file", "{broken}"], "broken.yaml"),
        (["--params-file", "/nowhere.yaml"], "/nowhere.yaml"),
        (["-r", "__node:=bad name"], "__node:=bad name"),
        (["-r", "__node:=9x"], "__node:=9x"),
        (["-r", "__ns:=bad//"], "__ns:=bad//"),
        (["-r", "__ns:=relative"], "__ns:=relative"),
        (["-r", "~/cables:=bad name"], "~/cables:=bad name"),
        (["-r", "rate"], "rate"),
        (["-p", "a b:=1"], "a b:=1"),
        (["-p", "1rate:=1"], "1rate:=1"),
        (["-p", "foo..bar:=1"], "foo..bar:=1"),
        (["-p", "rate:=[1"], "rate:=[1"),
        (["-p", "use_sim_time:=3"], "use_sim_time"),
        (["-p", "twin:=/a b"], "/a b/"),
        (["-p", "target_effector:=my tip"], "my tip"),
        (["--frobnicate"], "unknown arguments of ROS: ['--frobnicate']"),
        (["--log-level", "loud"], "loud"),
    ],
)
def test_invalid_ros_arguments_end_a_node_with_one_line(arguments, words, broken_file):
    given = [argument.format(broken=broken_file) for argument in arguments]
    done = run("target", "--ros-args", *given)
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("target: ") and words in line
    assert "Traceback" not in done.stderr and "/project/src" not in line


@pytest.mark.parametrize("node", NODES)
def test_a_non_ros_argument_is_refused(node):
    done = run(node, "--rate", "30")
    assert done.returncode == 2
    assert done.stderr == (f"{node}: unknown arguments --rate 30: arguments of ROS must "
                           "follow --ros-args; see --help\n")


@pytest.mark.parametrize(("node", "table"), [("twin", TWIN), ("device", DEVICE),
                                             ("target", TARGET)])
def test_help_names_topics_and_every_parameter_with_its_default(node, table):
    done = run(node, "--help")
    assert done.returncode == 0 and done.stderr == ""
    assert done.stdout.startswith(f"usage: {node} ")
    assert "geometry_msgs/P" in done.stdout and "Exit codes: " in done.stdout
    for entry in table:
        assert f"\n  {entry.name} " in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 100


def test_an_unknown_nested_parameter_is_reported_with_the_nearest_name(start):
    process, output = start("target", **{"target.radius": "0.01", "tagret_rate": "9.0"})
    wait_for("ready", process, output)
    told = output.read_text()
    assert "target.radius is unknown and ignored; did you mean target_radius?" in told
    assert "tagret_rate is unknown and ignored; did you mean target_rate?" in told


@pytest.mark.parametrize("delay", [0.15, 0.5, 1.0, 1.5, 2.0])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_a_node_starts_ends_it_cleanly(start, delay, number):
    process, output = start("twin")
    deadline = time.monotonic() + delay
    # Before the node's first line Python itself handles an interrupt; afterwards the node does.
    while not hears(process.pid) and process.poll() is None:
        time.sleep(0.005)
    time.sleep(max(0.0, deadline - time.monotonic()))
    process.send_signal(number)
    process.send_signal(number)
    assert process.wait(60.0) == 0, output.read_text()
    assert "Traceback" not in output.read_text() and "Exception ignored" not in output.read_text()


def hears(process):
    """Whether a process blocks signals, or catches SIGTERM: a plain Python does neither."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return False
    masks = {key: int(value, 16) for key, _, value in (line.partition(":") for line in lines)
             if key in ("SigBlk", "SigCgt")}
    return bool((masks["SigBlk"] | masks["SigCgt"]) & 1 << (signal.SIGTERM - 1))


def test_the_priority_of_the_ticks_is_reported(start):
    process, output = start("twin")
    wait_for("priority of the ticks: ", process, output)
    assert any(word in output.read_text() for word in ("real-time", "nice -10", "normal: "))
