"""How a recorded scene becomes a scene: rules by the name of a component, and a report.

A rule writes entries, or raises `NotConverted`. What no rule reads, components and fields, is listed.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from softrobot_twin.conversion.computed_values import (
    LoadedMesh,
    is_rigid,
    mapped_from,
    points_of,
    state_of,
    whole_of,
)
from softrobot_twin.conversion.scene_text import SOURCE
from softrobot_twin.conversion.scene_tree import (
    KINDS,
    TABLE,
    NotConverted,
    SceneComponent,
    SceneNode,
    first,
    walk,
)
from softrobot_twin.conversion.units import Units
from softrobot_twin.errors import one_line
from softrobot_twin.study.first_scene import made_name

_NOT_PHYSICAL, _NOT_PHYSICAL_FIELDS = (
    re.compile(TABLE[key].replace(" ", "")) for key in ("not_physical", "not_physical_fields"))  # fmt: skip
UNREADABLE = (ValueError, TypeError, IndexError, KeyError, ArithmeticError, RecursionError)
"""Errors of rules where a file has values of another kind or shape."""
_IDLE_EVENTS = ("init", "bwdInit", "reset", "onIdleEvent", "onSimulationInitDoneEvent")


class Rule(NamedTuple):
    """A rule.

    Attributes:
        stage: Rules of lower stages go first.
        convert: Writes entries; returns what they say, or None where nothing is to be told.
    """

    stage: int
    convert: Callable[[Conversion, SceneComponent], str | None]


RULES: dict[str, Rule] = {}
"""The rule of each kind of component."""
SETTINGS, BODIES, PARTS, FIXING, ACTUATORS, CONTACTS, PLANES = range(7)
"""Stages of rules."""


def rule(stage: int, *kinds: str):
    """Registers a rule.

    Args:
        stage: Its stage.
        *kinds: Kinds of components.
    """

    def register(convert: Callable) -> Callable:
        RULES.update(dict.fromkeys(kinds, Rule(stage, convert)))
        return convert

    return register


@dataclass(eq=False)
class BodyRecord:
    """A body that was converted.

    Attributes:
        name: Its name.
        entry: Its entry in the scene.
        state: Its state.
        mesh: Its points and cells, in the unit of the file.
        acting: Cells that each of its force fields acts on, by the identity of the field.
        materials: Its materials, each with its cells; the first is of all other cells.
    """

    name: str
    entry: dict[str, Any]
    state: SceneComponent
    mesh: LoadedMesh
    acting: dict[int, np.ndarray] = field(default_factory=dict)
    materials: list[tuple[dict[str, Any], np.ndarray]] = field(default_factory=list)


@dataclass(eq=False)
class Conversion:
    """A conversion that goes on.

    Attributes:
        root: The recorded tree.
        units: Its units.
        output: The scene file that is written.
        time_step: The step of the file [s].
        scene: Its sections.
        bodies: Deformable bodies, by the identity of their state.
        frames: Names of rigid bodies or of a beam for each frame of a rigid state, by its identity.
        goals: Identities of states that hold goals.
        surfaces: States of the surfaces that touch, by the name of their body or obstacle.
        missing: What has no counterpart: component, or None, and why.
        told: What was converted: component, and what it became.
        notes: Remarks.
        files: Writers of the files beside the scene, by their name.
        commands: Values of actuators in the file, by column.
        targets: Goals of effectors, by column.
    """

    root: SceneNode
    units: Units
    output: Path
    time_step: float
    scene: dict[str, Any] = field(default_factory=dict)
    bodies: dict[int, BodyRecord] = field(default_factory=dict)
    frames: dict[int, list[str]] = field(default_factory=dict)
    goals: set[int] = field(default_factory=set)
    surfaces: dict[str, SceneComponent] = field(default_factory=dict)
    missing: list[tuple[SceneComponent | None, str]] = field(default_factory=list)
    told: list[tuple[SceneComponent, str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    files: dict[str, Callable[[Path], None]] = field(default_factory=dict)
    commands: dict[str, float] = field(default_factory=dict)
    targets: dict[str, np.ndarray] = field(default_factory=dict)
    _names: set[str] = field(default_factory=set)

    @property
    def is_static(self) -> bool:
        """Whether the scene has no motion in time."""
        return self.scene.get("integration") == "quasi_static"

    @property
    def components(self) -> list[SceneComponent]:
        """All components, in the order of the tree."""
        return [one for node in walk(self.root) for one in node.components]

    def name(self, wanted: str, otherwise: str = "") -> str:
        """A name for an entry that no other one has.

        Args:
            wanted: The name that it should have.
            otherwise: The name where another entry has this one.
        """
        if otherwise and wanted in self._names:
            return self.name(otherwise)
        word = made_name(wanted, "part")
        made, number = word, 2
        while made in self._names or made == "world":
            made, number = f"{word}_{number}", number + 1
        self._names.add(made)
        return made

    def add(self, section: str, component: SceneComponent, entry: dict[str, Any], *told: str) -> dict:
        """Adds an entry to a section that is a list.

        Args:
            section: The section.
            component: Its source.
            entry: The entry.
            *told: Further lines of its comment.

        Returns:
            The entry.
        """
        entry = {SOURCE: [source_of(component), *told], **entry}
        self.scene.setdefault(section, []).append(entry)
        return entry

    def drop(self, key: str, reason: str) -> bool:
        """Takes out an entry that cannot be built, and lists its component.

        Args:
            key: What is wrong, such as ``cables[0].points`` or ``contact.points[0]``.
            reason: Why.

        Returns:
            Whether there is such an entry, which no other one may need.
        """
        found = re.match(r"(contact\.)?(\w+)\[(\d+)\]", key)
        if found is None or found[2] not in TABLE["unneeded"]:
            return False
        holder = self.scene["contact"] if found[1] else self.scene
        entry = holder[found[2]].pop(int(found[3]))
        if found[1] and not (holder.get("between") or holder["points"]):
            del self.scene["contact"]
        component = next(one for one in self.components if source_of(one) == entry[SOURCE][0])
        self.missing.append((component, f"cannot be built here: {reason}"))
        self.told = [one for one in self.told if one[0] is not component]
        for columns in (self.commands, self.targets):
            for column in [one for one in columns if one.startswith(f"{entry.get('name')}_")]:
                del columns[column]
        return True

    def length(self, values: Any) -> list:
        """Lengths in metres, as a list.

        Args:
            values: In the unit of the file, of any shape.
        """
        return rounded(np.asarray(values, float) * self.units.metre)

    def carrier(self, state: SceneComponent, index: int = 0) -> str | None:
        """Name of what carries the points of a state: a body, a rigid body; None for the world.

        Args:
            state: A state.
            index: One of its frames.

        Raises:
            NotConverted: It is carried by what was not converted.
        """
        if id(state) in self.bodies:
            return self.bodies[id(state)].name
        names, sources = self.frames.get(id(state)), mapped_from(state)
        if names is None and len(sources) == 1 and not is_rigid(state):
            names, mapping = self.frames.get(id(sources[0])), first(state.node, KINDS["mappings"])
            index = 0 if mapping is None else whole_of(mapping, "index")
        if names is not None:
            return names[min(index, len(names) - 1)] or None
        found = [name for name in map(self.carrier, sources) if name is not None]
        if sources and not found:
            raise NotConverted("what carries its points is not converted")
        return found[0] if found else None

    def needed_carrier(self, state: SceneComponent, index: int = 0) -> str:
        """The same, where the world can be none.

        Args:
            state: A state.
            index: One of its frames.

        Raises:
            NotConverted: Nothing that was converted carries it.
        """
        carrier = self.carrier(state, index)
        if carrier is None:
            raise NotConverted("its points are on no body that is converted")
        return carrier

    def record_of(self, name: str | None) -> BodyRecord | None:
        """The deformable body of a name; None where it is none.

        Args:
            name: The name.
        """
        return next((one for one in self.bodies.values() if one.name == name), None)

    def state(self, component: SceneComponent) -> SceneComponent:
        """The state that a component acts on.

        Args:
            component: The component.

        Raises:
            NotConverted: There is none.
        """
        found = state_of(component.node)
        if found is None:
            raise NotConverted("its node has no positions")
        return found

    def points(self, state: SceneComponent) -> np.ndarray:
        """Points of a state at rest [m], shape (count, 3).

        Args:
            state: A state.
        """
        return points_of(state) * self.units.metre

    def run(self) -> None:
        """Converts all components, and lists what no rule reads."""
        everything = self.components
        for component in sorted((one for one in everything if one.kind in RULES),
                                key=lambda one: RULES[one.kind].stage):  # fmt: skip
            try:
                told = RULES[component.kind].convert(self, component)
                self.told += [(component, told)] if told is not None else []
            except NotConverted as error:
                self.missing.append((component, str(error)))
            except UNREADABLE as error:  # values that nobody foresaw, of a foreign file
                reason = "its links go in a circle" if isinstance(error, RecursionError) else one_line(error)
                self.missing.append((component, f"cannot be read ({type(error).__name__}: {reason})"))
        states = [record.state for record in self.bodies.values()]
        for component in dict.fromkeys([*(one for one, _ in self.told), *states]):
            self._list_unread(component)
        for component in everything:
            if component.kind == "Controller" and self._is_by_keys(component):
                continue
            is_known = component.kind in RULES or any(component.kind in kinds for kinds in KINDS.values())
            if not is_known and not _NOT_PHYSICAL.fullmatch(component.kind):
                self.missing.append((component, TABLE["reasons"].get(component.kind, "has no counterpart here")))

    def _is_by_keys(self, controller: SceneComponent) -> bool:
        """Whether a controller of Python only listens to keys; then a note tells of teleoperation."""
        events = controller.fields.get("events") or []
        is_by_keys = bool(events) and all("key" in one.lower() or one in _IDLE_EVENTS for one in events)
        if is_by_keys:
            self.notes.append(f"{controller.name} ({controller.where}) moves things by keys: setpoints and targets "
                              "come over ROS here, see docs/topics.md")  # fmt: skip
        return is_by_keys

    def _list_unread(self, component: SceneComponent) -> None:
        for name, value in component.fields.items():
            is_known = name in component.read or _NOT_PHYSICAL_FIELDS.fullmatch(name)
            if not is_known and value not in (None, "", [], 0, 0.0, "0", False):
                self.missing.append((component, f"its field {name} = {str(value)[:40]} has no counterpart"))


def source_of(component: SceneComponent) -> str:
    """Component and place in words, for comments.

    Args:
        component: The component.
    """
    return f"{component.kind} {component.path}, {component.where}"


def rounded(values: Any) -> Any:
    """Numbers without the noise of a change of units: ten digits, as lists of floats.

    Args:
        values: An array or a number.
    """
    array = np.asarray(values, float)
    size = float(np.abs(array[np.isfinite(array)]).max(initial=0.0))
    if not size:
        return array.tolist()
    digits = int(11 - np.floor(np.log10(size)))
    return (np.round(array, min(digits, 15)) + 0.0).tolist()
