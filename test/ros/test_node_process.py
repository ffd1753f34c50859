"""The nodes as processes, from ``ros2 run`` to Ctrl-C."""

import json
import os
import signal
import subprocess
import sys
import time
from itertools import starmap
from pathlib import Path
from typing import NamedTuple

import pytest

from test.places import ROOT

NODES = ("twin", "device", "target")


@pytest.fixture(scope="module")
def begin(ros_domain, small_scene_file, tmp_path_factory):
    """Starts a node; its output goes to a file."""
    started = []

    def begin(node, **parameters):
        values = {"scene_file": small_scene_file, "device_scene_file": small_scene_file, **parameters}
        command = [sys.executable, "-m", "softrobot_twin.ros.process", node, "--ros-args"]
        for name, value in values.items():
            command += ["-p", f"{name}:={value}"]
        output = tmp_path_factory.mktemp("node") / f"{node}.log"
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONPATH": str(ROOT)}
        with output.open("wb") as file:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT,
                env=environment, start_new_session=True,
            )
        started.append(process)
        return process, output

    with ros_domain() as domain:
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


# Parameters that no node knows, and what is said of them.
UNKNOWN = {
    "traget_radius": "parameter traget_radius is unknown and ignored",
    "target.radius": "target.radius is unknown and ignored; did you mean target_radius?",
    "tagret_rate": "tagret_rate is unknown and ignored; did you mean target_rate?",
}


class Ended(NamedTuple):
    """A process after its end."""

    code: int
    output: str


@pytest.fixture(scope="module")
def interrupted(begin):
    """The three nodes, each started, interrupted when it was ready, and ended; by name."""
    nodes = {
        node: begin(node, **(dict.fromkeys(UNKNOWN, "0.01") if node == "target" else {}))
        for node in NODES
    }
    # A twin says this last.
    last = {"twin": "priority of the ticks: "}
    ended = {}
    for node, (process, output) in nodes.items():
        wait_for(last.get(node, "ready"), process, output)
        # The terminal and ros2 run both send one, ros2 launch another kind after some seconds, and
        # an impatient user more, until the process is gone.
        process.send_signal(signal.SIGINT)
        while process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.send_signal(signal.SIGTERM)
            time.sleep(0.01)
        ended[node] = Ended(process.wait(60.0), output.read_text())
    return ended


@pytest.mark.parametrize("node", NODES)
def test_an_interrupt_ends_a_node_cleanly(interrupted, node):
    assert interrupted[node].code == 0
    assert "Traceback" not in interrupted[node].output


@pytest.mark.parametrize("name", UNKNOWN)
def test_an_unknown_parameter_is_reported_with_the_nearest_name(interrupted, name):
    assert UNKNOWN[name] in interrupted["target"].output


def test_parameters_of_other_nodes_are_known(interrupted):
    # All nodes share one file.
    assert "scene_file is unknown" not in interrupted["target"].output


def test_the_priority_of_the_ticks_is_reported(interrupted):
    told = interrupted["twin"].output
    assert any(word in told for word in ("real-time", "nice -10", "normal: "))


# Settings that no node starts with, and what it says of them.
IMPOSSIBLE = [
    ("twin", "scene_file:=/nowhere.yaml", "parameter scene_file = '/nowhere.yaml'"),
    ("device", "device_scene_file:=/nowhere.yaml", "parameter device_scene_file"),
    ("target", "target_path:=spiral", "parameter target_path = 'spiral'"),
]
# Arguments of ROS that no node starts with, and what it says of them.
INVALID = [
    (["--params-file", "{broken}"], "broken.yaml"),
    (["--params-file", "/nowhere.yaml"], "/nowhere.yaml"),
    (["-r", "__node:=bad name"], "__node:=bad name"),
    (["-r", "__node:=9x"], "__node:=9x"),
    (["-r", "__ns:=/bad//"], "-r __ns:=/bad//: a namespace is made of names"),
    (["-r", "__ns:=/end/"], "-r __ns:=/end/: a namespace is made of names"),
    (["-r", "__ns:=relative"], "-r __ns:=relative: a namespace is made of names"),
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
]
# Starts nodes that end by themselves one after the other, because a process for each would take a
# second or two; libraries write to the file descriptors.
SCRIPT = """
import json, os, sys
from softrobot_twin.ros import process

given, told = sys.argv[1:]
answers = []
for node, arguments in json.load(open(given)):
    kept = [os.dup(1), os.dup(2)]
    files = [os.open(f"{told}.{end}", os.O_CREAT | os.O_TRUNC | os.O_RDWR) for end in ("out", "err")]
    for end, file in enumerate(files, 1):
        os.dup2(file, end)
    code = getattr(process, node)(arguments)
    sys.stdout.flush(), sys.stderr.flush()
    for end, file in enumerate(kept, 1):
        os.dup2(file, end)
    for file in (*kept, *files):
        os.close(file)
    answers.append([code, *(open(f"{told}.{end}").read() for end in ("out", "err"))])
json.dump(answers, open(told, "w"))
"""


class Answer(NamedTuple):
    """What a node that ended by itself returned and wrote."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """Answers of nodes that end by themselves: because of an error, or after printing their help."""
    folder = tmp_path_factory.mktemp("answers")
    broken, given, told = folder / "broken.yaml", folder / "given.json", folder / "told.json"
    broken.write_text("/**: [")
    (folder / "script.py").write_text(SCRIPT)
    asked = {
        f"{node} {' '.join(arguments)}": (node, arguments)
        for node in NODES for arguments in (["--rate", "30"], ["--help"])
    }  # fmt: skip
    for arguments, _ in INVALID:
        own = [argument.format(broken=broken) for argument in arguments]
        asked[f"target {' '.join(arguments)}"] = "target", ["--ros-args", *own]
    for node, setting, _ in IMPOSSIBLE:
        asked[f"{node} {setting}"] = node, ["--ros-args", "-p", setting]
    given.write_text(json.dumps(list(asked.values())))
    subprocess.run(
        [sys.executable, folder / "script.py", given, told], cwd=ROOT, check=True, timeout=200,
        env={**os.environ, "PYTHONPATH": str(ROOT)}, stdin=subprocess.DEVNULL,
    )  # fmt: skip
    return dict(zip(asked, starmap(Answer, json.loads(told.read_text())), strict=True))


@pytest.mark.parametrize(("node", "setting", "words"), IMPOSSIBLE)
def test_an_impossible_setting_ends_a_node_with_one_line_and_exit_code_2(node, setting, words, answers):
    done = answers[f"{node} {setting}"]
    assert done.returncode == 2
    told = [line for line in done.stderr.splitlines() if line.startswith(f"{node}: ")]
    assert len(told) == 1 and words in told[0]
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(("arguments", "words"), INVALID)
def test_invalid_ros_arguments_end_a_node_with_one_line(arguments, words, answers):
    done = answers[f"target {' '.join(arguments)}"]
    assert done.returncode == 2
    (line,) = done.stderr.strip().splitlines()
    assert line.startswith("target: ") and words in line
    assert "Traceback" not in done.stderr and "/project/src" not in line


@pytest.mark.parametrize("node", NODES)
def test_a_non_ros_argument_is_refused(node, answers):
    done = answers[f"{node} --rate 30"]
    assert done.returncode == 2
    assert done.stderr == (f"{node}: unknown arguments --rate 30: arguments of ROS must "
                           "follow --ros-args; see --help\n")


@pytest.mark.parametrize(("number", "delay"), [
    (signal.SIGINT, 0.15), (signal.SIGTERM, 1.0),
])  # fmt: skip
def test_an_interrupt_while_a_node_starts_ends_it_cleanly(begin, delay, number):
    process, output = begin("twin")
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
