"""What a demo starts: three processes, their parameters, and the environment they share."""

from __future__ import annotations

import os
import socket
from dataclasses import dataclass
from pathlib import Path

import yaml

from softrobot_twin.control.loop_settings import Mode
from softrobot_twin.errors import ParameterError
from softrobot_twin.ros.parameters import TARGET, TWIN
from softrobot_twin.ros.scene_file import config_folders, find_scene_file

START_TOPIC = "/demo/start"
"""Where the target hears that its path begins, and from where: it would else begin as soon as the
twin publishes, before everybody has found everybody."""

_DEFAULTS = {entry.name: entry.default for entry in (*TARGET, *TWIN)}


@dataclass(frozen=True)
class DemoPlan:
    """A demo, before anything is started.

    Attributes:
        robot: Name of the robot.
        parameter_file: ROS parameters of all three nodes.
        scene_file: The twin's scene.
        effector: Effector that is driven.
        run_time: Length of each of the two runs [s].
        turn_time: Length of each path within a run [s].
        ramp_time: Time to come onto a path [s].
        period: Time between the twin's ticks [s].
        view_port: Port that viewers join, or None without a view.
        opens_viewer: True when there is a display to open a viewer on.
        folder: Where the recording and the processes' logs go.
    """

    robot: str
    parameter_file: Path
    scene_file: Path
    effector: str
    run_time: float
    turn_time: float
    ramp_time: float
    period: float
    view_port: int | None
    opens_viewer: bool
    folder: Path

    @property
    def record_file(self) -> Path:
        """What the twin records for rerun."""
        return self.folder / "run.rrd"

    @property
    def view_address(self) -> str:
        """Where a viewer joins."""
        return f"rerun+http://127.0.0.1:{self.view_port}/proxy"

    def command(self, node: str) -> list[str]:
        """Module and arguments of a node, as after ``python -m``."""
        overrides = {"twin": self._twin_overrides, "target": self._target_overrides}
        arguments = [f"softrobot_twin.ros.{node}", "--ros-args",
                     "--params-file", str(self.parameter_file)]
        for name, value in overrides.get(node, dict)().items():
            arguments += ["-p", f"{name}:={_as_yaml(value)}"]
        if node == "target":
            arguments += ["-r", f"/twin/effectors/{self.effector}:={START_TOPIC}"]
        return arguments

    def _twin_overrides(self) -> dict[str, object]:
        overrides: dict[str, object] = {
            "use_device": True, "closed_loop": False, "mode": "inverse",
            "record_file": str(self.record_file.resolve()),
            "view": self.view_port is not None, "view_spawn": self.opens_viewer,
        }
        if self.view_port is not None:
            overrides["view_port"] = self.view_port
        return overrides

    def _target_overrides(self) -> dict[str, object]:
        return {"target_sequence_time": self.turn_time, "target_ramp_time": self.ramp_time}


def plan_demo(robot: str, folder: Path, run_time: float, view: bool) -> DemoPlan:
    """Plans a demo.

    Args:
        robot: ``config/<robot>.yaml`` says which.
        folder: Where results go; made when it is not there.
        run_time: Length of each run [s].
        view: Serve viewers, and open one where there is a display.

    Raises:
        ParameterError: There is no such robot, it takes no targets, or its parameters cannot be
            used.
    """
    file = _parameter_file(robot)
    values = _DEFAULTS | _parameters(file)
    if values["mode"] != Mode.INVERSE.value:
        raise ParameterError("robot", robot, "", f"is driven in {values['mode']} mode, see {file}: "
                             "a demo leads effectors to targets, which this robot does not take")
    paths = [name for name in values["target_sequence"] if name] or [values["target_path"]]
    turn_time = run_time / len(paths)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError("output", str(folder), "", f"cannot be made: {error}") from error
    display = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return DemoPlan(
        robot=robot, parameter_file=file,
        scene_file=find_scene_file(str(values["scene_file"]), "scene_file"),
        effector=str(values["target_effector"]), run_time=run_time, turn_time=turn_time,
        # A short run has no time for a slow start.
        ramp_time=min(float(values["target_ramp_time"]), 0.25 * turn_time),
        period=1.0 / float(values["rate"]),
        view_port=_port(int(values["view_port"])) if view else None,
        opens_viewer=view and display, folder=folder)


def isolate(environment: dict[str, str] | os._Environ) -> str:
    """Keeps a demo to this machine and, unless the user chose a domain, to itself.

    Args:
        environment: Changed in place; the processes inherit it.

    Returns:
        The ROS domain.
    """
    environment.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    # From 102 on a domain's ports would be those that Linux hands out to anybody.
    return environment.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 101))


def _parameter_file(robot: str) -> Path:
    folders = config_folders()
    for folder in folders:
        if (folder / f"{robot}.yaml").is_file():
            return (folder / f"{robot}.yaml").resolve()
    known = sorted({file.stem for folder in folders for file in folder.glob("*.yaml")})
    raise ParameterError("robot", robot, "", f"must be one of {', '.join(known) or 'none'}; "
                         f"looked for {robot}.yaml in {', '.join(map(str, folders))}")


def _parameters(file: Path) -> dict[str, object]:
    """Parameters of all nodes in one; no name has two meanings."""
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
        sections = [section["ros__parameters"] for section in content.values()]
        return {name: value for section in sections for name, value in section.items()}
    except (OSError, UnicodeDecodeError, yaml.YAMLError, AttributeError, KeyError,
            TypeError) as error:
        raise ParameterError("robot", str(file), "",
                             f"is no ROS parameter file: {error!r}") from error


def _port(wanted: int) -> int:
    """The wanted port when it is free, else another free one."""
    for port in (wanted, 0):
        with socket.socket() as probe:
            # As a server would bind: a port that a past demo just left is free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return probe.getsockname()[1]
    raise ParameterError("view_port", wanted, "", "no port is free on this machine")


def _as_yaml(value: object) -> str:
    """A parameter's value as ROS reads it: as YAML, where 30 would be no double."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    return repr(value)
