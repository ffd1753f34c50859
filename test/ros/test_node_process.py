"""The nodes as processes: what ``ros2 run`` starts and Ctrl-C ends."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NODES = ("twin", "device", "target")


@pytest.fixture
def start(ros_domain_id, small_scene_file, tmp_path):
    """Starts a node; its output goes to a file."""
    started = []

    def begin(node, **parameters):
        values = {"scene_file": small_scene_file, "device_scene_file": small_scene_file,
                  **parameters}
        command = [sys.executable, "-m", f"softrobot_twin.ros.{node}", "--ros-args"]
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


def test_a_request_to_end_does_too(start):
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
def test_what_cannot_be_ends_a_node_with_one_line_and_exit_code_2(start, node, parameters, words):
    process, output = start(node, **parameters)
    assert process.wait(60.0) == 2
    told = [line for line in output.read_text().splitlines() if line.startswith(f"{node}: ")]
    assert len(told) == 1 and words in told[0]
    assert "Traceback" not in output.read_text()


def test_a_parameter_that_nobody_knows_is_told(start):
    process, output = start("target", traget_radius="0.01")
    wait_for("ready", process, output)
    assert "parameter traget_radius is unknown and ignored" in output.read_text()
    # Those of the other nodes are known: one file serves them all.
    assert "scene_file is unknown" not in output.read_text()


def test_a_parameter_file_that_is_none_ends_a_node_with_one_line(start, tmp_path):
    file = tmp_path / "broken.yaml"
    file.write_text("/**: [")
    command = [sys.executable, "-m", "softrobot_twin.ros.target", "--ros-args",
               "--params-file", str(file)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=60, check=False, stdin=subprocess.DEVNULL
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "target: " in done.stderr
