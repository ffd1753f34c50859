"""Texts of ``twin --help``, ``device --help`` and ``target --help``."""

from __future__ import annotations

from collections.abc import Sequence
from textwrap import fill

from softrobot_twin.ros.parameters import DEVICE, TARGET, TWIN, Entry
from softrobot_twin.ros.topics import NODES, TWIN_SERVICES, Direction

_TABLES: dict[str, tuple[Entry, ...]] = {"twin": TWIN, "device": DEVICE, "target": TARGET}
_ABOUT = {
    "twin": """\
Runs the simulation of a soft robot in real time: targets in, cable lengths and
pressures out. Pressures are absolute in FluidPressure, gauge in JointState;
motors of hinges have angles and torques there, in rad and N m.""",
    "device": """\
A simulated robot: receives a twin's cable lengths and pressures, publishes measured ones and
markers. Pressures are absolute in FluidPressure, gauge in JointState.""",
    "target": """\
Publishes targets along a path for an effector of a twin.""",
}


def _topics_of(name: str) -> list[str]:
    """A line for each topic and service of a node: direction, name, type, unit."""
    topics = NODES[name].values()
    width = min(30, max(len(topic.name) for topic in topics))
    types = max(len(topic.type_name) for topic in topics)
    lines = []
    for direction in Direction:
        for index, topic in enumerate(one for one in topics if one.direction is direction):
            word = direction.value if index == 0 else ""
            line = f"  {word:3}  {topic.name:{width}}  {topic.type_name:{types}}  {topic.unit}"
            lines.append(line.rstrip())
    if name == "twin":
        services = ", ".join(f"{one.name} ({one.type_name})" for one in TWIN_SERVICES)
        lines.append(fill(services, 96, initial_indent="  services  ", subsequent_indent=" " * 12))
    return lines


def help_of(name: str) -> str:
    """Usage, topics and parameters of a node.

    Args:
        name: ``twin``, ``device`` or ``target``.
    """
    return help_text(name, [_ABOUT[name], "", *_topics_of(name)], _TABLES[name])


def help_text(name: str, about: Sequence[str], table: Sequence[Entry]) -> str:
    """Usage, lines about a node and its parameters, for any node.

    Args:
        name: Its executable.
        about: Lines that say what it does.
        table: Its parameters.
    """
    usage = (f"usage: {name} [-h] [--ros-args [--params-file FILE] [-p NAME:=VALUE ...]"
             " [-r FROM:=TO ...]]")
    lines = [usage, "", *about, "", "Parameters (-p NAME:=VALUE; * can be set while it runs):"]
    for entry in table:
        unit = f" {entry.unit}" if entry.unit else ""
        star = "" if entry.read_only else " *"
        choices = f" One of {', '.join(entry.choices)}." if entry.choices else ""
        lines.append(f"  {entry.name}{star} (default {_shown(entry.default)}{unit})")
        lines.append(fill(entry.description + choices, 96, initial_indent=" " * 6,
                          subsequent_indent=" " * 6))
    lines += ["", "A double needs its point: rate:=30.0. use_sim_time:=true ticks on /clock.",
              "Exit codes: 0 after SIGINT or SIGTERM, 2 when the node cannot start."]
    return "\n".join(lines)


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, str) else str(value)
