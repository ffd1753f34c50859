"""The demo: twin, device and target run as three processes. A robot that follows targets runs
open loop, then closed loop; one that is driven directly plays its commands.

The file contains, in this order: processor use, the plan, the processes, the recorder, the run.
"""

from __future__ import annotations

import json
import math
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import rclpy
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, PointStamped, Vector3Stamped
from nav_msgs.msg import Path as PathMessage
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool

from softrobot_twin.control.loop_settings import Mode
from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.errors import NamedError, ParameterError, SoftRobotTwinError
from softrobot_twin.ros.messages import READERS, read_path
from softrobot_twin.ros.parameters import DEVICE, TARGET, TWIN
from softrobot_twin.ros.scene_file import config_folders, find_scene, find_scene_file
from softrobot_twin.scene import load_scene
from softrobot_twin.shared_files import ScenePath

NOTICEABLE_SHARE = 0.1
"""If other programs use a larger share of the processor, the demo's times are affected."""
_IDLE, _IOWAIT, _GUEST = 3, 4, 8
"""Columns of /proc/stat: idle time, waiting time, and the first column that repeats others."""
_SESSION, _USER, _SYSTEM = 3, 11, 12
"""Columns of /proc/<process>/stat after the program's name."""


class ProcessorTimes(NamedTuple):
    """Times since the machine started [s].

    Attributes:
        moment: Time of the reading, on a monotonic clock.
        busy: Working time of the selected cores, summed.
        own: Processor time of the selected sessions, summed.
        cores: Number of the selected cores.
    """

    moment: float
    busy: float
    own: float
    cores: int


def processor_times(sessions: Iterable[int], cores: Collection[int]) -> ProcessorTimes:
    """Reads how long the processor has worked since the machine started.

    Args:
        sessions: Ids of the demo's own sessions; this process is counted too.
        cores: The cores to count.

    Raises:
        OSError: This system has no such tables.
    """
    tick = os.sysconf("SC_CLK_TCK")
    allowed = {f"cpu{core}" for core in cores}
    busy = 0
    for line in Path("/proc/stat").read_text().splitlines():
        name, *words = line.split()
        if name in allowed:
            counts = [int(word) for word in words[:_GUEST]]
            busy += sum(counts) - counts[_IDLE] - counts[_IOWAIT]
    wanted, own, here = set(sessions), 0, os.getpid()
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            # The program's name may contain spaces and brackets.
            words = (entry / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(entry.name) == here or int(words[_SESSION]) in wanted:
            own += int(words[_USER]) + int(words[_SYSTEM])
    return ProcessorTimes(time.monotonic(), busy / tick, own / tick, len(cores))


def share_of_others(before: ProcessorTimes, after: ProcessorTimes) -> float:
    """Share of the processor that other programs used between two readings, 0 to 1.

    Both readings must be taken while all processes of the demo run: the time of a process that has
    ended is no longer listed.

    Args:
        before: The earlier reading.
        after: The later one.
    """
    whole = (after.moment - before.moment) * after.cores
    others = (after.busy - before.busy) - (after.own - before.own)
    return min(1.0, max(0.0, others / whole)) if whole > 0.0 else 0.0


RUNS = ("open_loop", "closed_loop")
CONTROLLED_RUNS = ("dynamic", "quasi_static")
"""Of a scene whose control predicts: by prediction, then as if the robot stood."""
DIRECT_RUNS = ("direct",)
_SWITCHED = {"closed_loop": ("closed_loop", True), "quasi_static": ("prediction", False)}
"""Parameter of the twin that is set as a run begins, and its value."""
_LEAST_RAMPS = 4.0
"""A path of a run is shown for at least this many of its transitions."""

START_TOPIC = "/demo/start"
"""The target starts when it receives its start point on this topic. On the twin's own topic it
would receive one as soon as the twin publishes, before all nodes are connected.
"""

_DEFAULTS = {entry.name: entry.default for entry in (*TARGET, *DEVICE, *TWIN)}


class DemoCalibration(NamedTuple):
    """How a demo calibrates the twin by its device.

    Attributes:
        device_scene: The device's scene.
        count: Number of poses at rest.
        box: Least and greatest place of the effector [m], shape (2, 3).
        noise: Standard deviation of measured markers [m].
        seed: Seed of the noise.
    """

    device_scene: ScenePath
    count: int
    box: tuple
    noise: float
    seed: int


@dataclass(frozen=True)
class DemoPlan:
    """Settings of a demo.

    Attributes:
        robot: Name of the robot.
        parameter_file: ROS parameters of all three nodes.
        scene_file: The twin's scene, with other values of its entries.
        effector: Effector that is driven or, where commands are played, compared.
        touch: Touch where the device's fingertip presses; empty for none.
        runs: Names of the runs, in order: `RUNS`, only the first of them where no marker measures
            an effector, `CONTROLLED_RUNS`, or `DIRECT_RUNS` where commands are played.
        run_time: Length of each run [s].
        paths: Paths of a run, in turn; empty where commands are played.
        turn_time: Length of each path within a run [s].
        ramp_time: Duration of the transition onto a path [s].
        period: Time between the twin's ticks [s].
        tells_ahead: Whether the path of the targets is told ahead.
        view_port: Port to which viewers connect, or None without a view.
        opens_viewer: True when a viewer is opened, which needs a display.
        folder: Folder of the recording and of the processes' logs.
        calibration: How the twin is calibrated for a last run; None where it is not.
    """

    robot: str
    parameter_file: Path
    scene_file: ScenePath
    effector: str
    touch: str
    runs: tuple[str, ...]
    run_time: float
    paths: tuple[str, ...]
    turn_time: float
    ramp_time: float
    period: float
    tells_ahead: bool
    view_port: int | None
    opens_viewer: bool
    folder: Path
    calibration: DemoCalibration | None = None

    @property
    def is_direct(self) -> bool:
        """True when commands are played and no targets followed."""
        return self.runs == DIRECT_RUNS

    def command(self, node: str) -> list[str]:
        """Module and arguments of a node, to follow ``python -m``.

        Args:
            node: ``twin``, ``device`` or ``target``.
        """
        view = {} if self.view_port is None else {"view_port": self.view_port}
        # The file too: a calibrated twin has another one than its parameters name.
        scene: dict[str, object] = {"scene_file": str(self.scene_file)}
        if self.scene_file.changes:
            scene["scene_changes"] = self.scene_file.changes
        # The target's other parameters belong to paths.
        of_paths = {"target_sequence": list(self.paths), "target_sequence_time": self.turn_time,
                    "target_ramp_time": self.ramp_time}  # fmt: skip
        overrides: Mapping[str, Mapping[str, object]] = {
            "twin": {**scene, "use_device": True, "closed_loop": self.runs == CONTROLLED_RUNS,
                     "record_file": str((self.folder / "run.rrd").resolve()), "view": bool(view),
                     "view_spawn": self.opens_viewer, **view},
            "device": {}, "target": scene if self.is_direct else of_paths,
        }  # fmt: skip
        arguments = ["softrobot_twin.ros.process", node, "--ros-args",
                     "--params-file", str(self.parameter_file)]
        for name, value in overrides[node].items():
            # JSON is YAML, and a float keeps its decimal point: ROS reads 30 as an integer.
            arguments += ["-p", f"{name}:={json.dumps(value, ensure_ascii=False)}"]
        if node == "target":
            arguments += ["-r", f"/twin/effectors/{self.effector}:={START_TOPIC}"]
        return arguments


def plan_demo(robot: str, folder: Path, run_time: float, view: bool, changes: Sequence[str] = ()) -> DemoPlan:
    """Plans a demo.

    Args:
        robot: Name of a parameter file, ``config/<robot>.yaml``.
        folder: Folder for results; created if necessary.
        run_time: Length of each run [s].
        view: Serve viewers, and open one where there is a display.
        changes: Other values of entries of the twin's scene, after those of its parameter file.

    Raises:
        ParameterError: There is no such robot, it neither follows targets nor plays commands, or
            its parameters cannot be used.
        SceneError: Its scene cannot be used.
    """
    if (file := _parameter_files().get(robot)) is None:
        looked = ", ".join(map(str, config_folders()))
        raise ParameterError("robot", robot, "", f"must be one of {_known_robots()}; "
                             f"looked for {robot}.yaml in {looked}")
    values = _DEFAULTS | _parameters(file)
    if not _has_demo(values):
        raise ParameterError(
            "robot", robot, "", f"is driven in direct mode, and target_commands names no file in "
            f"{file}: there is nothing to show; robots with a demo: {_known_robots()}")
    is_direct = values["mode"] == Mode.DIRECT.value
    if is_direct:
        find_scene_file(str(values["target_commands"]), "target_commands")
    ramp_time = float(values["target_ramp_time"])
    paths = [name for name in values["target_sequence"] if name] or [values["target_path"]]
    # A path keeps its own pace: in a short run there are fewer of them, not faster ones.
    count = int(min(len(paths), max(1.0, run_time // (_LEAST_RAMPS * ramp_time or run_time))))
    turn_time = run_time / count
    values["scene_changes"] = (*values["scene_changes"], *changes)
    scene_file = find_scene(values)
    scene = load_scene(scene_file)
    is_measured = any(effector.measured_by for effector in scene.effectors)
    runs = RUNS if is_measured else RUNS[:1]
    if is_measured and scene.control is not None and scene.control.law == "dynamic":
        runs = CONTROLLED_RUNS
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError("output", str(folder), "", f"cannot be created: {error}") from error
    display = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return DemoPlan(
        robot=robot, parameter_file=file,
        scene_file=scene_file, effector=str(values["target_effector"]),
        touch=str(values["device_touch"]),
        runs=DIRECT_RUNS if is_direct else runs,
        run_time=run_time, paths=() if is_direct else tuple(paths[:count]), turn_time=turn_time,
        ramp_time=min(ramp_time, 0.5 * turn_time),
        period=1.0 / float(values["rate"]), tells_ahead=bool(values["target_ahead"]),
        view_port=_port(int(values["view_port"])) if view else None,
        opens_viewer=view and display, folder=folder, calibration=_calibration(values))


def _calibration(values: Mapping[str, Any]) -> DemoCalibration | None:
    """How a demo calibrates by the values of its parameters; None where it does not."""
    if not values["device_calibration_poses"]:
        return None
    return DemoCalibration(
        find_scene(values, "device_scene"), int(values["device_calibration_poses"]),
        (values["workspace_min"], values["workspace_max"]), float(values["device_marker_noise"]),
        int(values["device_seed"]))


def isolate(environment: dict[str, str] | os._Environ) -> str:
    """Limits ROS discovery to this machine and, unless the user chose a domain, to this demo.

    Args:
        environment: Changed in place; the processes inherit it.

    Returns:
        The ROS domain.
    """
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # The ports of domains above 101 overlap with Linux's range of temporary ports.
    return environment.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 101))


def _parameter_files() -> dict[str, Path]:
    """The parameter file of each robot."""
    # A folder before another one hides its files.
    return {file.stem: file.resolve() for folder in reversed(config_folders())
            for file in folder.glob("*.yaml")}  # fmt: skip


def _known_robots() -> str:
    """Names of the robots that have a demo, as text."""
    return ", ".join(demo_robots()) or "none"


def demo_robots() -> tuple[str, ...]:
    """Names of the robots that have a demo: those whose parameter file drives them."""
    return tuple(name for name, file in sorted(_parameter_files().items())
                 if _has_demo(_DEFAULTS | _parameters(file)))  # fmt: skip


def _has_demo(values: Mapping[str, object]) -> bool:
    """Whether parameters lead an effector, or name commands to play."""
    return values["mode"] == Mode.INVERSE.value or bool(values["target_commands"])


def _parameters(file: Path) -> dict[str, object]:
    """Parameters of all nodes in one table; their names are unique across nodes."""
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
        sections = [section["ros__parameters"] for section in content.values()]
        return {name: value for section in sections for name, value in section.items()}
    except (OSError, UnicodeDecodeError, yaml.YAMLError, AttributeError, KeyError, TypeError) as error:
        raise ParameterError("robot", str(file), "", f"is not a ROS parameter file: {error!r}") from error


def _port(wanted: int) -> int:
    """The wanted port when it is free, else another free one."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            # Bind as a server does: a port that an earlier demo has just released counts as free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return probe.getsockname()[1]
    raise ParameterError("view_port", wanted, "", "no port is free on this machine")


LAST_LINES = 15
"""Number of last lines of an ended process's output that the error contains."""

_NICE = 5
"""Nice value of all processes but the twin on a machine with a single core."""

_COMPILED = re.compile(r"compiled \d+ of at most \d+ kernels")
_SIGNAL_TIMEOUTS = ((signal.SIGINT, 10.0), (signal.SIGTERM, 5.0), (signal.SIGKILL, 5.0))
"""Signals that request the end of a process, and the wait after each of them [s]."""


class ProcessorShare(NamedTuple):
    """The cores and the nice value of a process.

    Attributes:
        nice: Increment of its nice value.
        cores: Cores that it may use.
    """

    nice: int
    cores: frozenset[int]

    def give(self, process: int) -> None:
        """Applies this share to a process and to its future children; 0 is this process.

        Args:
            process: Number of the process.
        """
        with suppress(OSError):  # It has ended, which is reported elsewhere, or a container forbids it.
            os.sched_setaffinity(process, self.cores)
            if self.nice:
                before = os.getpriority(os.PRIO_PROCESS, process)
                os.setpriority(os.PRIO_PROCESS, process, before + self.nice)


def processor_shares(cores: Iterable[int]) -> tuple[ProcessorShare, ProcessorShare]:
    """Processor shares of the twin and of all other processes.

    The twin gets the first half of the cores, all others get the second half. On a single core the
    others get a higher nice value. The simulated device computes as much as the twin, which a real
    robot would not, so it must not take time from the twin.

    Args:
        cores: Cores that the demo may use.
    """
    every = sorted(cores)
    if len(every) == 1:
        return ProcessorShare(0, frozenset(every)), ProcessorShare(_NICE, frozenset(every))
    half = len(every) // 2
    # No nice value here: on a busy machine the device would be late, which a real robot is not.
    return ProcessorShare(0, frozenset(every[:half])), ProcessorShare(0, frozenset(every[half:]))


class ProcessDiedError(SoftRobotTwinError):
    """A process of the demo ended while it was still needed.

    Attributes:
        name: Name of the process.
        exit_code: Its exit code; negative is the signal that ended it.
        last_lines: Last lines of its output.
    """

    def __init__(self, name: str, exit_code: int, last_lines: Sequence[str]):
        self.name, self.exit_code, self.last_lines = name, exit_code, tuple(last_lines)
        super().__init__(f"{name} ended with exit code {exit_code}")


class DemoProcess:
    """A Python module that runs as a separate process and writes its output into a file.

    The process has its own session, so that Ctrl-C on the terminal reaches only the demo, which
    then ends each process once and in order. It inherits the whole environment, because the ROS
    wheels prepare the environment before Python starts and record this in a variable.

    Args:
        name: Name within the demo.
        command: Module and its arguments, as after ``python -m``.
        log: File for its output.
        place: Its cores and nice value, or None for those of this process.
    """

    def __init__(self, name: str, command: Sequence[str], log: Path, place: ProcessorShare | None = None):
        self.name = name
        self.log = log
        with log.open("wb") as file:
            self._process = subprocess.Popen(
                [sys.executable, "-m", *command], stdin=subprocess.DEVNULL, stdout=file,
                stderr=subprocess.STDOUT, env=dict(os.environ), start_new_session=True)
        if place is not None:
            place.give(self._process.pid)

    @property
    def session(self) -> int:
        """Id of its session, which its children share."""
        return self._process.pid

    @property
    def exit_code(self) -> int | None:
        """Exit code, or None while the process runs."""
        return self._process.poll()

    def check_running(self) -> None:
        """Raises:
            ProcessDiedError: It no longer runs.
        """
        if self.exit_code is not None:
            raise ProcessDiedError(self.name, self.exit_code, self.last_lines())

    def last_lines(self) -> list[str]:
        """The end of its output."""
        text = self.log.read_text(encoding="utf-8", errors="replace")
        return text.splitlines()[-LAST_LINES:]

    def written(self) -> int:
        """Size of its output [bytes]."""
        return self.log.stat().st_size

    def compiles(self) -> str:
        """What it compiles, such as ``twin compiled 42 of at most 380 kernels``; empty where its
        last line tells of something else.
        """
        found = _COMPILED.search((self.last_lines() or [""])[-1])
        return f"{self.name} {found[0]}" if found else ""

    def send(self, number: signal.Signals) -> None:
        """Sends a signal to the process and its children; does nothing when it has ended.

        Args:
            number: The signal.
        """
        if self.exit_code is None:
            os.killpg(self._process.pid, number)

    def wait(self, seconds: float) -> bool:
        """Waits for the end; True when the process ended within this time.

        Args:
            seconds: The longest time [s].
        """
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True


def stop_all(processes: Sequence[DemoProcess]) -> dict[str, int | None]:
    """Ends all processes at the same time, with stronger signals for those that stay.

    Args:
        processes: The processes.

    Returns:
        Exit code by name; 0 for a process that ended cleanly at the first signal.
    """
    for number, timeout in _SIGNAL_TIMEOUTS:
        waiting = [process for process in processes if process.exit_code is None]
        for process in waiting:
            process.send(number)
        deadline = time.monotonic() + timeout
        for process in waiting:
            process.wait(max(0.0, deadline - time.monotonic()))
    return {process.name: process.exit_code for process in processes}


_ALL = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)


class Samples:
    """Values with their times, in order of arrival.

    Attributes:
        times: Time of each [s], growing.
        values: Each a list of floats, all of one length.
    """

    def __init__(self) -> None:
        self.times: list[float] = []
        self.values: list[list[float]] = []

    def add(self, time: float, value: list[float]) -> None:
        """Adds a sample; a sample that is not newer than the last one is ignored.

        Args:
            time: Its time [s].
            value: Its numbers, as many as those of the others.
        """
        if not self.times or time > self.times[-1]:
            self.times.append(time)
            self.values.append(value)

    def between(self, start: float, end: float) -> tuple[np.ndarray, np.ndarray]:
        """Times [s], shape (n,), and values, shape (n, width), of ``start <= time < end``.

        Args:
            start: The first time that counts [s].
            end: The first time that does not count any more [s].
        """
        times = np.array(self.times)
        first, last = np.searchsorted(times, (start, end)) if len(times) else (0, 0)
        width = len(self.values[0]) if self.values else 0
        return times[first:last], np.array(self.values[first:last]).reshape(last - first, width)


class LoopReport(NamedTuple):
    """Timing of the twin's loop, from one diagnostics message.

    Attributes:
        compute_p50: Median compute time of the last ticks [s].
        compute_p99: 99th percentile [s].
        compute_max: Longest [s].
        ticks: Ticks since its start.
        missed: Ticks that ended late.
        skipped: Ticks that were skipped.
        statuses: Number of ticks of each status since the message before, by its word.
    """

    compute_p50: float
    compute_p99: float
    compute_max: float
    ticks: int
    missed: int
    skipped: int
    statuses: Mapping[str, int]


class DemoRecorder(Node):
    """Records the messages of a twin, its device and its targets.

    Args:
        effector: Effector that is driven or compared.
        is_direct: Commands are played; there are no targets.
        touch: Touch where the device's fingertip presses; empty for none.
        tells_ahead: Whether targets come as paths.

    Attributes:
        target: Target positions of the effector [m]; none where commands are played.
        twin_effector: Effector positions predicted by the twin [m].
        device_effector: True effector positions [m], which only a simulated device can publish.
        stiffness: Wanted stiffnesses of the effector along x, y and z [N/m].
        twin_touch: Displacement [m] and force [N] of the touch, as the twin answers.
        device_touch: The same as sensors of the device measure them.
        setpoints: Commanded setpoints, each in the unit of its kind, such as cable lengths [m].
        efforts: Efforts of the twin, each in the unit of its kind, such as tensions [N].
        actuator_names: Actuators in this order; empty before the first command.
        loop_reports: The twin's reports of its loop, the newest last.
        priority: Priority of the twin's ticks as reported; empty before the first report.
        cause: Reported reason for a large tracking error; empty when there is none.
    """

    def __init__(self, effector: str, is_direct: bool, touch: str, tells_ahead: bool = False):
        super().__init__("demo")
        self.is_direct = is_direct
        self.target, self.twin_effector, self.device_effector = Samples(), Samples(), Samples()
        self.stiffness, self.twin_touch, self.device_touch = Samples(), Samples(), Samples()
        self.setpoints, self.efforts = Samples(), Samples()
        self.actuator_names: tuple[str, ...] = ()
        self.loop_reports: list[LoopReport] = []
        self.priority = self.cause = ""
        self._targets = self._record(PointStamped, f"/twin/target/{effector}", self.target)
        if tells_ahead:
            self._targets = self.create_subscription(
                PathMessage, f"/twin/target_path/{effector}", self._take_path, _ALL)
        self._record(PointStamped, f"/twin/effectors/{effector}", self.twin_effector)
        self._record(PointStamped, f"/device/effectors/{effector}", self.device_effector)
        if touch:
            self._record(JointState, f"/twin/touch/{touch}", self.twin_touch)
            self._record(JointState, f"/device/touch/{touch}", self.device_touch)
            self._record(Vector3Stamped, f"/twin/target_stiffness/{effector}", self.stiffness)
        self._start = self.create_publisher(PointStamped, START_TOPIC, _ALL)
        self.create_subscription(JointState, "/twin/cables", self._take_cables, _ALL)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._take_diagnostics, 10)

    def _record(self, kind: type, topic: str, samples: Samples) -> Subscription:
        """Records the numbers of a topic's messages."""

        def take(message: Any) -> None:
            parts = READERS[kind](message)[-2:]  # Of joints without their names.
            samples.add(_seconds(message.header), [number for part in parts for number in part])

        return self.create_subscription(kind, topic, take, _ALL)

    def _take_path(self, message: PathMessage) -> None:
        """Records where the target is at the time of the message."""
        _, places = read_path(message)
        self.target.add(_seconds(message.header), list(places[0]))

    @property
    def reference(self) -> Samples:
        """What the device is compared with: the target or, where commands are played, the twin."""
        return self.twin_effector if self.is_direct else self.target

    def error(self) -> float:
        """Newest distance of the device from the reference [m]; NaN before both are known."""
        if not self.reference.times or not self.device_effector.times:
            return math.nan
        time, position = self.device_effector.times[-1], self.device_effector.values[-1]
        times, values = self.reference.between(time - 1.0, math.inf)
        if not len(times):
            return math.nan
        target = [float(np.interp(time, times, column)) for column in values.T]
        return math.dist(target, position)

    def target_is_found(self) -> bool:
        """True when the target is connected in both directions; commands are not received here."""
        return (self._start.get_subscription_count() > 0
                and (self.is_direct or self._targets.get_publisher_count() > 0))

    def start_target(self) -> float:
        """Starts the target's path at the present position of the twin's effector, or its commands.

        Returns:
            The time [s].
        """
        x, y, z = self.twin_effector.values[-1]
        message = PointStamped(point=Point(x=x, y=y, z=z))
        message.header.stamp = self.get_clock().now().to_msg()
        self._start.publish(message)
        return _seconds(message.header)

    def _take_cables(self, message: JointState) -> None:
        if not self.actuator_names:
            self.actuator_names = tuple(message.name)
        time = _seconds(message.header)
        self.setpoints.add(time, list(message.position))
        self.efforts.add(time, list(message.effort))

    def _take_diagnostics(self, message: DiagnosticArray) -> None:
        parts = {status.name: {pair.key: pair.value for pair in status.values}
                 for status in message.status}
        fields = parts.get("twin: loop")
        if fields is None:
            return
        self.priority = fields["priority"]
        counts = parts["twin: solver"].get("statuses", "").split()
        self.loop_reports.append(LoopReport(
            *(1e-3 * float(fields[f"compute_{key}_ms"]) for key in ("p50", "p99", "max")),
            *(int(fields[key]) for key in ("ticks", "missed", "skipped")),
            {word: int(count) for word, _, count in (one.partition(":") for one in counts)}))
        self.cause = parts["twin: target"].get("error_cause", "")


def _seconds(header) -> float:
    return header.stamp.sec + header.stamp.nanosec / NANOSECONDS


_START_TIMEOUT = 180.0
"""Longest time of the start without a new line in the log of a node [s]. A node that compiles kernels
writes one every few seconds."""
_ANSWER_TIMEOUT = 60.0
"""Longest wait for an answer of a running process [s]."""
_WATCH_PERIOD = 0.1
"""Time between two checks of the processes and updates of the status line [s]."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class _StopRequested(Exception):
    """A signal requested the end of the demo."""


class DemoError(NamedError):
    """A process of the demo, which the error names, does not do what the demo needs."""


class DemoStatus(NamedTuple):
    """Content of the status line.

    Attributes:
        elapsed: Time since the demo began [s].
        phase: Present phase of the demo.
        error: Distance of the device from the target, or where commands are played from the twin
            [m]; NaN when not known.
        compute_time: Median time of the twin's last steps [s]; NaN when not known.
        missed_ticks: Ticks missed so far.
        cause: Why the error is large; empty when it is not.
    """

    elapsed: float
    phase: str
    error: float
    compute_time: float
    missed_ticks: int
    cause: str


@dataclass
class DemoOutcome:
    """Result of a demo.

    Attributes:
        recorder: The recorded messages.
        starts: Start time of each run [s], by name; runs that did not start are missing.
        end: End time of the last run [s].
        reports_before: Number of loop reports received before the first run.
        was_stopped: True when Ctrl-C ended it.
        exit_codes: Exit codes of the processes, by name.
        others: Share of the processor that other programs used during the runs, 0 to 1; None when
            it is not known.
    """

    recorder: DemoRecorder
    starts: dict[str, float]
    end: float
    reports_before: int
    was_stopped: bool
    exit_codes: dict[str, int | None]
    others: float | None = None

    def span(self, run: str) -> tuple[float, float]:
        """Start and end of a run [s].

        Args:
            run: Name of the run.
        """
        later = [start for start in self.starts.values() if start > self.starts[run]]
        return self.starts[run], min(later, default=self.end)


class Demo:
    """Runs a planned demo once.

    Args:
        plan: The plan.
        show_status: Called with the status about ten times a second.

    Attributes:
        processes: The nodes that were started.
        executor: Runs the recorder.
        phase: What is done at present, for the status.
    """

    def __init__(self, plan: DemoPlan, show_status: Callable[[DemoStatus], None]):
        self._plan, self._show_status = plan, show_status
        self._cores = os.sched_getaffinity(0)
        self.processes: list[DemoProcess] = []
        self._starts: dict[str, float] = {}
        self._end = -math.inf
        self._reports_before = 0
        self._times_before: ProcessorTimes | None = None
        self._began = self._looked = time.monotonic()
        self.phase = ""
        self._stop_requested = False

    def run(self) -> DemoOutcome:
        """Runs it; always ends every process that it started.

        Raises:
            ProcessDiedError: A process ended by itself.
            DemoError: A process did not answer.
        """
        isolate(os.environ)
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._recorder = DemoRecorder(self._plan.effector, self._plan.is_direct, self._plan.touch,
                                      self._plan.tells_ahead)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self._recorder)
        was_stopped = False
        # Also for SIGINT: a shell starts background jobs with SIGINT ignored.
        previous = {number: signal.signal(number, self._record_stop_signal) for number in _SIGNALS}
        try:
            self._drive()
        except _StopRequested:
            was_stopped = True
        finally:
            # A second Ctrl-C is only recorded, so all processes are ended; every wait has a time
            # limit.
            others = self._share_of_others()
            exit_codes = stop_all(self.processes)
            self._recorder.destroy_node()
            rclpy.try_shutdown()
            for number, handler in previous.items():
                signal.signal(number, handler)
        end = min(self._end, self._last_reference())
        return DemoOutcome(self._recorder, self._starts, end, self._reports_before, was_stopped,
                           exit_codes, others)

    def _record_stop_signal(self, number: int, frame: object) -> None:
        """Records a signal. An exception raised here could interrupt rclpy, which would raise
        another.
        """
        self._stop_requested = True

    def _drive(self) -> None:
        """Starts the processes and waits for the end of the last run."""
        recorder = self._recorder
        self.phase = "starting"
        of_twin, of_rest = processor_shares(self._cores)
        for node, place in (("twin", of_twin), ("device", of_rest), ("target", of_rest)):
            log = self._plan.folder / f"{node}.log"
            self.processes.append(DemoProcess(node, self._plan.command(node), log, place))
        # After the start of the nodes, because children inherit the share of this process.
        of_rest.give(0)
        self.until(lambda: recorder.twin_effector.times and recorder.device_effector.times,
                   _START_TIMEOUT, "twin", "twin and device do not publish effectors", True)
        self.until(recorder.target_is_found, _START_TIMEOUT, "target", "it was not found", True)
        self.phase = "enabling"
        self._enable()
        self.until(lambda: recorder.setpoints.times, _ANSWER_TIMEOUT, "twin", "it commands no cables")
        start = recorder.start_target()
        if not self._plan.is_direct:
            # A target that plays commands first begins its path where the effector is after them.
            self.until(lambda: recorder.target.times or not recorder.start_target(), _ANSWER_TIMEOUT,
                       "target", "it publishes nothing")
            start = recorder.target.times[0]
        self._reports_before = len(recorder.loop_reports)
        self._times_before = self._processor_times()
        for number, run in enumerate(self._plan.runs):
            self.phase = run.replace("_", " ")
            if run in _SWITCHED:
                self._switch(*_SWITCHED[run])
            self._starts[run] = start + number * self._plan.run_time
            self._end = start + (number + 1) * self._plan.run_time
            self.until(lambda: self._last_reference() >= self._end,
                        self._plan.run_time + _ANSWER_TIMEOUT,
                        "twin" if self._plan.is_direct else "target", "it stopped publishing")
        self.phase = "ending"

    def _processor_times(self) -> ProcessorTimes | None:
        try:
            return processor_times((process.session for process in self.processes), self._cores)
        except OSError:
            return None

    def _share_of_others(self) -> float | None:
        """Share of the processor that other programs used since the runs began."""
        before, after = self._times_before, self._processor_times()
        return None if before is None or after is None else share_of_others(before, after)

    def _last_reference(self) -> float:
        times = self._recorder.reference.times
        return times[-1] if times else -math.inf

    def _enable(self) -> None:
        """Repeats the request until the twin has received measurements and accepts it."""
        client = self._recorder.create_client(SetBool, "/twin/enable")
        deadline = time.monotonic() + _ANSWER_TIMEOUT
        while True:
            answer = self._ask(client, SetBool.Request(data=True), "/twin/enable")
            if answer.success:
                return
            if time.monotonic() > deadline:
                raise DemoError("twin", f"cannot be enabled: {answer.message}")
            due = time.monotonic() + 0.2
            self.until(lambda: time.monotonic() >= due, _ANSWER_TIMEOUT, "twin", "")

    def _switch(self, parameter_name: str, value: bool) -> None:
        name = "/twin/set_parameters"
        client = self._recorder.create_client(SetParameters, name)
        parameter = Parameter(parameter_name, value=value).to_parameter_msg()
        request = SetParameters.Request(parameters=[parameter])
        (result,) = self._ask(client, request, name).results
        if not result.successful:
            raise DemoError("twin", f"{parameter_name} cannot be set: {result.reason}")

    def _ask(self, client, request, name: str):
        """Answer of a service."""
        self.until(client.service_is_ready, _ANSWER_TIMEOUT, "twin", f"offers no service {name}")
        future = client.call_async(request)
        self.until(future.done, _ANSWER_TIMEOUT, "twin", f"does not answer on {name}")
        return future.result()

    def until(self, is_done: Callable[[], object], timeout: float, name: str,
               reason: str, is_starting: bool = False) -> None:
        """Receives messages until a condition holds; checks the processes meanwhile.

        Args:
            is_done: The condition.
            timeout: Longest wait [s]; while nodes start, from the last line that one of them wrote.
            name: The node that is waited for.
            reason: What it does not do.
            is_starting: Whether nodes start, which may compile kernels for minutes.

        Raises:
            ProcessDiedError: A process ended.
            DemoError: The condition did not hold within the timeout.
            _StopRequested: A signal was received.
        """
        deadline, written = time.monotonic() + timeout, 0
        while not is_done():
            if self._stop_requested:
                raise _StopRequested
            self.executor.spin_once(timeout_sec=0.02)
            now = time.monotonic()
            if now - self._looked < _WATCH_PERIOD:
                continue
            self._looked = now
            for process in self.processes:
                process.check_running()
            if is_starting and (size := sum(one.written() for one in self.processes)) != written:
                deadline, written = now + timeout, size
                self.phase = next(filter(None, (one.compiles() for one in self.processes)),
                                   "starting")  # fmt: skip
            self._show_status(self.status(now))
            if now > deadline:
                raise DemoError(name, f"{reason}, waited {timeout:g} s; see {name}.log in "
                                f"{self._plan.folder}")

    def status(self, now: float) -> DemoStatus:
        """The present status at a monotonic time [s].

        Args:
            now: Time on the monotonic clock [s].
        """
        loop_reports = self._recorder.loop_reports
        before = loop_reports[self._reports_before - 1].missed if self._reports_before else 0
        return DemoStatus(
            now - self._began, self.phase, self._recorder.error(),
            loop_reports[-1].compute_p50 if loop_reports else math.nan,
            loop_reports[-1].missed - before if loop_reports else 0,
            self._recorder.cause)
