"""The demo: its plan, its processes, its record, and a complete run as a command."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from softrobot_twin.command_line.commands import enable_interrupts
from softrobot_twin.errors import ParameterError, SceneError
from softrobot_twin.ros.demo import (
    CONTROLLED_RUNS,
    Demo,
    DemoError,
    DemoProcess,
    ProcessDiedError,
    demo_robots,
    isolate,
    plan_demo,
    stop_all,
)
from softrobot_twin.scene import load_scene
from softrobot_twin.shared_files import ScenePath
from softrobot_twin.study.run_plot import read_series
from softrobot_twin.tables.column_names import position_columns, target_name
from test.places import ROOT

NODES = ("twin", "device", "target")
FIGURES = {"mean_error_mm", "max_error_mm", "mean_twin_misfit_mm", "samples", "seconds"}


# --- the plan --------------------------------------------------------------------------------


def test_the_twin_starts_open_loop_disabled_and_records(tmp_path):
    plan = plan_demo("diamond", tmp_path, 30.0, view=False)
    twin = plan.command("twin")
    assert twin[:4] == ["softrobot_twin.ros.process", "twin", "--ros-args", "--params-file"]
    assert Path(twin[4]).name == "diamond.yaml"
    assert {"use_device:=true", "closed_loop:=false", "view:=false",
            f'record_file:="{tmp_path / "run.rrd"}"'} <= set(twin)


def test_a_robot_without_markers_runs_open_loop_only(tmp_path, monkeypatch):
    scene = (ROOT / "config" / "scenes" / "octoleg.yaml").read_text().replace(
        "    measured_by: [0]\n", "").replace("../../meshes", str(ROOT / "meshes"))
    (tmp_path / "blind.yaml").write_text(scene)
    (tmp_path / "robot.yaml").write_text(
        f"/**: {{ros__parameters: {{mode: inverse, scene_file: {tmp_path / 'blind.yaml'}}}}}")
    monkeypatch.setattr("softrobot_twin.ros.demo.config_folders", lambda: [tmp_path])
    assert plan_demo("robot", tmp_path / "demo", 5.0, view=False).runs == ("open_loop",)


def test_changes_reach_the_twins_scene_and_who_reads_it_and_not_the_device(tmp_path):
    stiffer = "body.material.young_modulus=2e5"
    plan = plan_demo("diamond", tmp_path, 5.0, view=False, changes=(stiffer,))
    assert load_scene(plan.scene_file).body.material.young_modulus == 2e5
    told = f'scene_changes:=["{stiffer}"]'
    assert [told in plan.command(node) for node in NODES] == [True, False, False]
    played = plan_demo("grasper", tmp_path, 5.0, view=False, changes=("gravity=[0,0,-1]",))
    assert 'scene_changes:=["gravity=[0,0,-1]"]' in played.command("target")
    with pytest.raises(SceneError, match="rat = 1: is not a key"):
        plan_demo("diamond", tmp_path, 5.0, view=False, changes=("cables.north.rat=1",))


def test_a_twin_that_was_calibrated_runs_with_its_new_scene(tmp_path):
    plan = replace(plan_demo("diamond", tmp_path, 5.0, view=False), scene_file=ScenePath(tmp_path / "new.yaml", ()))
    told = f'scene_file:="{tmp_path / "new.yaml"}"'
    assert [told in plan.command(node) for node in NODES] == [True, False, False]


def test_a_scene_whose_control_predicts_is_led_by_prediction_and_then_as_if_it_stood(tmp_path):
    plan = plan_demo("fast_trunk", tmp_path, 5.0, view=False)
    assert plan.runs == CONTROLLED_RUNS == ("dynamic", "quasi_static") and plan.tells_ahead
    assert "closed_loop:=true" in plan.command("twin")


def test_a_robot_that_is_driven_directly_plays_its_commands_in_one_run(tmp_path):
    plan = plan_demo("grasper", tmp_path, 5.0, view=False)
    assert plan.is_direct and plan.runs == ("direct",) and plan.paths == ()
    assert plan.effector == "cube"
    assert not [word for word in plan.command("target") if "target_sequence" in word]
    assert not [word for word in plan.command("twin") if "mode" in word], "the file's mode stays"


@pytest.mark.parametrize("robot", ["pneunet"])
def test_a_robot_without_targets_and_commands_is_refused_with_those_that_have_a_demo(robot, tmp_path):
    with pytest.raises(ParameterError, match="direct mode.*target_commands.*diamond, .*octoleg"):
        plan_demo(robot, tmp_path, 10.0, view=False)
    assert robot not in demo_robots()


def test_commands_that_are_not_there_are_refused(tmp_path, monkeypatch):
    given = (ROOT / "config" / "octoleg.yaml").read_text()
    (tmp_path / "octoleg.yaml").write_text(given.replace("octoleg_curl.csv", "nowhere.csv"))
    monkeypatch.setattr("softrobot_twin.ros.demo.config_folders", lambda: [tmp_path])
    with pytest.raises(ParameterError, match="no such file") as caught:
        plan_demo("octoleg", tmp_path, 10.0, view=False)
    assert caught.value.name == "target_commands"


def test_a_port_in_use_is_not_taken(tmp_path):
    import socket
    wanted = plan_demo("diamond", tmp_path, 30.0, view=True).view_port
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        taken.bind(("127.0.0.1", wanted))
        taken.listen()
        assert plan_demo("diamond", tmp_path, 30.0, view=True).view_port not in (0, wanted)


def test_without_a_display_no_viewer_is_opened(tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not plan_demo("diamond", tmp_path, 30.0, view=True).opens_viewer
    monkeypatch.setenv("DISPLAY", ":0")
    assert plan_demo("diamond", tmp_path, 30.0, view=True).opens_viewer
    assert not plan_demo("diamond", tmp_path, 30.0, view=False).opens_viewer


def test_an_unknown_robot_is_refused_with_the_known_names(tmp_path):
    with pytest.raises(ParameterError, match="must be one of diamond, .*octoleg.*trunk") as caught:
        plan_demo("unicorn", tmp_path, 30.0, view=False)
    assert (caught.value.name, caught.value.value) == ("robot", "unicorn")


def test_a_domain_that_the_user_chose_is_kept():
    environment = {"ROS_DOMAIN_ID": "7"}
    assert isolate(environment) == "7"
    assert environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert 1 <= int(isolate({})) <= 101


# --- samples ---------------------------------------------------------------------------------


# --- processes -------------------------------------------------------------------------------

@pytest.fixture
def module(tmp_path, monkeypatch):
    """Makes a module that can be run as a process."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)

    def make(name, code):
        (tmp_path / f"{name}.py").write_text(code)
        return DemoProcess(name, [name], tmp_path / f"{name}.log")
    return make


def await_line(process, line):
    deadline = time.monotonic() + 60.0
    while line not in process.last_lines():
        assert time.monotonic() < deadline
        time.sleep(0.02)


PATIENT = """
import time
try:
    print('ready', flush=True)
    while True: time.sleep(0.01)  # A signal just before one long sleep would wait for its end.
except KeyboardInterrupt:
    print('left', flush=True)
"""


@pytest.mark.parametrize("in_background", [False, True])
def test_processes_end_cleanly_on_request(module, in_background):
    # A background process of a script ignores SIGINT, and its children would inherit that.
    before = signal.signal(signal.SIGINT, signal.SIG_IGN if in_background else signal.default_int_handler)
    try:
        enable_interrupts()
        ask_two_to_leave(module)
    finally:
        signal.signal(signal.SIGINT, before)


def ask_two_to_leave(module):
    processes = [module(name, PATIENT) for name in ("first", "second")]
    for process in processes:
        await_line(process, "ready")
        process.check_running()
    assert stop_all(processes) == {"first": 0, "second": 0}
    assert [process.last_lines()[-1] for process in processes] == ["left", "left"]


def test_a_process_that_died_is_reported_with_its_last_lines(module):
    process = module("mortal", "import sys\nprint('it was so dark', file=sys.stderr)\nsys.exit(3)")
    assert process.wait(60.0)
    with pytest.raises(ProcessDiedError) as caught:
        process.check_running()
    assert (caught.value.name, caught.value.exit_code) == ("mortal", 3)
    assert caught.value.last_lines == ("it was so dark",)
    assert stop_all([process]) == {"mortal": 3}


COMPILING = """
import time
for count in range(8):
    print(f'softrobot_twin: compiled {count} of at most 60 kernels in 9 s, now a.b', flush=True)
    time.sleep(0.5)
time.sleep(60)
"""


@pytest.mark.exhaustive
def test_the_start_is_waited_for_as_long_as_a_node_tells_of_its_progress(module, tmp_path, monkeypatch):
    shown = []
    demo = Demo(SimpleNamespace(folder=tmp_path), shown.append)
    demo.processes = [module("twin", COMPILING)]
    demo.executor = SimpleNamespace(spin_once=lambda timeout_sec: time.sleep(timeout_sec))
    monkeypatch.setattr(demo, "status", lambda now: demo.phase)
    line = "softrobot_twin: compiled 1 of at most 60 kernels in 9 s, now a.b"
    await_line(demo.processes[0], line)
    with pytest.raises(DemoError, match="it is late, waited 2 s"):
        demo.until(lambda: False, 2.0, "twin", "it is late", is_starting=True)
    assert "twin compiled 7 of at most 60 kernels" in shown
    stop_all(demo.processes)


# --- the whole -------------------------------------------------------------------------------

class RunningDemo:
    """``python -m softrobot_twin demo``, with what it writes in files.

    Args:
        folder: Where its results, in ``demo``, and its files go.
        domain: Its ROS domain.
        arguments: Its further arguments.
    """

    def __init__(self, folder, domain, *arguments):
        self.folder = folder
        self._told = [folder / f"{stream}.log" for stream in ("output", "errors")]
        environment = dict(os.environ, ROS_DOMAIN_ID=str(domain), MARK=str(folder))
        with self._told[0].open("wb") as output, self._told[1].open("wb") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "softrobot_twin", "demo", "--no-view", "--output",
                 str(folder / "demo"), *arguments],
                cwd=ROOT, env=environment, stdin=subprocess.DEVNULL, stdout=output, stderr=errors)

    @property
    def output(self):
        return self._told[0].read_text()

    @property
    def errors(self):
        return self._told[1].read_text()

    def has_ended(self):
        return self._process.poll() is not None

    def until(self, condition, timeout=200.0):
        """Waits until a condition holds; fails where the demo ends before."""
        deadline = time.monotonic() + timeout
        while not condition():
            assert not self.has_ended() and time.monotonic() < deadline, self.errors
            time.sleep(0.05)

    def until_led(self):
        """Waits until the first of its runs begins, or its end."""
        words = ("open loop  ", "direct  ")
        self.until(lambda: self.has_ended() or any(word in self.errors for word in words))

    def interrupt(self):
        self._process.send_signal(signal.SIGINT)

    def result(self, timeout=280.0):
        """Waits for its end, and gives its exit code."""
        return self._process.wait(timeout)

    def end(self):
        if not self.has_ended():
            self._process.terminate()
            self._process.wait(60.0)


@pytest.fixture
def demo(tmp_path, ros_domain_id):
    """Starts a demo and ends it also when the test fails."""
    started = []

    def start(*arguments):
        started.append(RunningDemo(tmp_path, ros_domain_id, *arguments))
        return started[-1]

    yield start
    for one in started:
        one.end()


def children_of(folder):
    """Nodes of the processes whose command line contains this folder, by process id."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            command = (entry / "cmdline").read_bytes().split(b"\0")
            is_ours = os.fsencode(folder) in (entry / "environ").read_bytes()
        except OSError:
            continue
        nodes = [node for node in NODES
                 if b"softrobot_twin.ros.process" in command and node.encode() in command]
        if is_ours and nodes:
            found[int(entry.name)] = nodes[0]
    return found


def report_of(folder):
    return json.loads((folder / "report.json").read_text())


@pytest.mark.exhaustive
def test_ctrl_c_ends_all_three_processes_and_writes_the_report(demo, tmp_path):
    process = demo("--seconds", "60")
    process.until_led()
    time.sleep(3.0)
    assert sorted(children_of(tmp_path).values()) == sorted(NODES)
    process.interrupt()
    assert process.result() == 130, process.errors
    errors = process.errors
    assert errors.strip().splitlines()[-1] == "softrobot_twin: stopped"
    assert "did not end cleanly" not in errors
    assert children_of(tmp_path) == {}
    report = report_of(tmp_path / "demo")
    assert report["complete"] is False and report["closed_loop"] is None
    assert report["open_loop"]["seconds"] < 30.0


@pytest.mark.exhaustive
def test_a_node_that_dies_ends_the_demo_with_its_last_output(demo, tmp_path):
    process = demo("--seconds", "60")
    process.until(lambda: len(children_of(tmp_path)) == len(NODES))
    os.kill(next(number for number, node in children_of(tmp_path).items() if node == "device"),
            signal.SIGKILL)
    assert process.result() == 1
    assert "device ended with exit code -9" in process.errors
    assert "Traceback" not in process.errors
    assert children_of(tmp_path) == {}


# --- the robots of the paper -----------------------------------------------------------------

TRAVEL = None
ROBOTS = dict.fromkeys(("diamond", "trunk", "grasper", "octoleg", "fetch", "flexo"), TRAVEL)
ROBOTS["stifface"] = 0.004
"""The robots of Table 1 of Coevoet 2017, each with what its error is a share of: the travel of its
effector, or a length [m] where the effector is held in place: the thickness of the pad."""
LED = ROBOTS | dict.fromkeys(("finger", "fast_pneunet"), TRAVEL)
LED["pneunet_in_hand"] = 0.005
"""These, the finger that README begins with, one that is cast, and a ball in the hand."""
SECONDS = dict.fromkeys(LED, 5.0) | {"diamond": 8.0, "pneunet_in_hand": 8.0}
"""Length of each run of a robot's demo [s]."""
LATEST = 0.5
"""A busy machine makes a robot late: it must be where it should have been within this time [s]."""
LARGEST_ERROR = 0.2
"""Mean distance of a device from where it should be, as that share. Devices are up to
15 % softer than their twins, and their cables run up to 1 mm beside levers of 10 mm and more: the
root of both squares is 18 %."""
LEAST_TRAVEL = 5e-3
MOST_NOT_CONVERGED = 0.1
"""Share of steps that may end with a residual above what is allowed."""
FAILURES = {"inverted", "refused", "unsolved", "diverged"}
BUSY = 0.5
"""With a smaller share of the ticks, errors say something of the machine, not of the robot."""
DISTURBED = 0.9
"""So they do with this share while other programs use more than a tenth of the processor, or where a
node came so late that a run could not be compared: alone, every robot has 0.99 of its ticks, and
others use 0.04."""


def distances_to_recent(reference_times, reference, times, points):
    """Least distance of each point from the reference during the time before it [m]."""
    found = []
    for time, point in zip(times, points, strict=True):
        recent = (reference_times >= time - LATEST) & (reference_times <= time)
        if recent.any():
            found.append(np.linalg.norm(reference[recent] - point, axis=1).min())
    return np.array(found)


class LedDemos:
    """The demos of robots, each run once and alone: beside another that starts, the Grasper's device
    is late and lets its cube fall.

    Args:
        folder: Makes a folder of a name.
        domain: Makes the context of a ROS domain.
    """

    def __init__(self, folder, domain):
        self._folder, self._domain, self._demos = folder, domain, {}

    def __call__(self, robot):
        """The demo of a robot after its end."""
        if robot not in self._demos:
            with self._domain() as domain:
                demo = self._demos[robot] = RunningDemo(
                    self._folder(robot), domain, "--robot", robot, "--seconds", str(SECONDS[robot]))
                try:
                    demo.result()
                finally:
                    demo.end()
        demo = self._demos[robot]
        assert demo.result() == 0, demo.errors
        return demo


@pytest.fixture(scope="module")
def led(tmp_path_factory, ros_domain):
    """Demos of robots after their end, by the robot's name."""
    return LedDemos(tmp_path_factory.mktemp, ros_domain)


@pytest.mark.exhaustive
@pytest.mark.parametrize("robot", LED)
def test_the_demo_leads_the_robot(led, robot):
    demo = led(robot)
    folder = demo.folder / "demo"
    logs = ((folder / f"{node}.log").read_text() for node in NODES)
    for text in (demo.output, demo.errors, *logs):
        assert "Traceback" not in text and "Exception" not in text, text
    report = report_of(folder)
    assert report["robot"] == robot and report["complete"] is True
    steps = report["steps"]
    count = sum(steps.values())
    assert not FAILURES & steps.keys() and count > 10, steps
    assert steps.get("not_converged", 0) <= MOST_NOT_CONVERGED * count, steps
    done = report["ticks"] / (report["ticks"] + report["skipped_ticks"])
    others = report["processor_share_of_others"] or 0.0
    plan = plan_demo(robot, folder, SECONDS[robot], view=False)
    runs = [run for run in plan.runs if report[run]]
    is_busy = done < (DISTURBED if others > 0.1 or len(runs) < len(plan.runs) else BUSY)
    load = (f"{100 * done:.0f} % of the ticks took place, other programs used "
            f"{100 * others:.0f} % of the processor")
    assert is_busy or runs == list(plan.runs), load
    for run in runs:
        series = read_series(folder / f"{run}.csv")
        twin, device, target = (
            np.column_stack([series.numbers.get(name, series.at) for name in position_columns(thing)])
            for thing in (plan.effector, f"{plan.effector}_device", target_name(plan.effector)))
        apart = distances_to_recent(series.at, twin if plan.is_direct else target, series.at, device)
        travel = np.linalg.norm(twin - twin[0], axis=1).max()
        print(f"{robot}, {run}: mean {1e3 * apart.mean():.2f} mm of {1e3 * travel:.0f} mm; "
              f"{steps}; {load}")
        assert is_busy or LED[robot] is not TRAVEL or travel > LEAST_TRAVEL, load
        assert is_busy or apart.mean() < LARGEST_ERROR * (LED[robot] or travel), load
    if is_busy:
        pytest.skip(f"the machine was too busy to judge the errors: {load}")


@pytest.mark.exhaustive
def test_a_short_demo_halves_the_error_and_writes_all_documented_files(led):
    demo = led("diamond")
    folder = demo.folder / "demo"
    report = report_of(folder)
    assert report["robot"] == "diamond" and report["complete"] is True
    for run in ("open_loop", "closed_loop"):
        assert set(report[run]) == FIGURES
        assert 0.0 < report[run]["mean_error_mm"] <= report[run]["max_error_mm"] < 100.0
        assert report[run]["seconds"] == pytest.approx(8.0, abs=0.5)
    assert report["closed_to_open_ratio"] == pytest.approx(
        report["closed_loop"]["mean_error_mm"] / report["open_loop"]["mean_error_mm"])
    # This run is short and half of it are ramps. The gain of the closed loop is tested in simulated
    # time in test/control/test_closed_loop.py, where the error falls to a fifth.
    assert report["closed_to_open_ratio"] < 0.5
    compute = report["compute_time_ms"]
    assert 0.0 < compute["median"] <= compute["p99"] <= compute["max"]
    assert report["ticks"] > 10 and report["missed_ticks"] >= 0 and report["period_ms"] > 0.0
    assert report["twin_priority"].split(":")[0] in ("real-time, SCHED_FIFO 5", "nice -10", "normal")
    assert 0.0 <= report["processor_share_of_others"] <= 1.0
    busy = report["processor_share_of_others"] > 0.1
    assert ("times above are not representative" in " ".join(demo.output.split())) == busy
    assert report["mesh"]["dof"] <= 3 * report["mesh"]["nodes"]
    assert {"python", "numpy", "scipy", "daqp", "rerun", "rclpy"} <= set(report["versions"])
    assert (folder / "tracking.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "run.rrd").stat().st_size > 10_000
    assert "closed loop / open loop" in demo.output
    for phase in ("starting", "open loop", "closed loop"):
        assert phase in demo.errors
