"""Stand-ins of what SOFA's Python modules offer a scene: nodes, components, their data, controllers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from traceback import walk_stack
from typing import Any, ClassVar

import numpy as np

from softrobot_twin.conversion.scene_tree import (
    KINDS,
    UNKNOWN,
    NotConverted,
    SceneComponent,
    SceneNode,
    first,
    follow,
    is_link,
    named,
    numbers,
    root_of,
)


class Attributes:
    """Gives what is no attribute of Python's own: a method of a scene's interface, or what a class says."""

    _OWN: ClassVar[tuple[str, ...]] = ()
    _METHODS: ClassVar[dict[str, Callable]] = {}

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in self._OWN:
            raise AttributeError(name)
        return partial(self._METHODS[name], self) if name in self._METHODS else self._attribute(name)

    def _attribute(self, name: str) -> Any:
        """An attribute of which nothing is known."""
        return Nothing()


class Nothing(Attributes):
    """Stands for what nothing is known of: every attribute, call and sum of it is nothing."""

    def __init__(self, *given: Any, label: str = "", **more: Any):
        """Accepts everything, also what a class statement gives to its base.

        Args:
            *given: The name of a class, perhaps.
            label: Its dotted name; empty where calls of it mean nothing.
            **more: Not read.
        """
        self.__dict__["label"] = label or (given[0] if given and isinstance(given[0], str) else "")

    def _attribute(self, name: str) -> Any:
        return Nothing(label=self.label and f"{self.label}.{name}")

    def __call__(self, *given: Any, **more: Any) -> Any:
        if self.label and any(isinstance(one, Node) for one in (*given, *more.values())):
            Recorder.note_unknown(self.label)
        # A decorator gives back what it decorates.
        return given[0] if len(given) == 1 and not more and callable(given[0]) else Nothing(label=self.label)

    def __iter__(self) -> Iterator:
        Recorder.note_unknown(self.label)
        return iter(())

    def __enter__(self) -> Nothing:
        return self


_OPERATORS = ("getitem", "neg", "add", "radd", "sub", "rsub", "mul", "rmul", "truediv", "rtruediv")
for _name, _value in {"bool": False, "str": "", "setitem": None, "exit": None}.items():
    setattr(Nothing, f"__{_name}__", lambda self, *given, _value=_value: _value)
for _name, _value in {"len": 0, "float": 0.0, "int": 0}.items():
    setattr(Nothing, f"__{_name}__", lambda self, *given, _value=_value: Recorder.note_unknown(self.label) or _value)
for _name in _OPERATORS:
    setattr(Nothing, f"__{_name}__", lambda self, *given: Nothing(label=self.label))


class Recorder:
    """What all stand-ins share: where the scene is, and how values are computed.

    Attributes:
        folder: Folder of the scene.
        unknown: What was called with a node and is not known: name, file and line.
    """

    folder: Path
    unknown: ClassVar[list[tuple[str, str, int]]] = []

    @classmethod
    def note_unknown(cls, name: str) -> None:
        """Keeps that a scene called something unknown, which may have added components, or read a value of it.

        Args:
            name: Its name; empty where it means nothing.
        """
        if name:
            cls.unknown.append((name, *cls.place()))

    @classmethod
    def place(cls) -> tuple[str, int]:
        """File and line of the scene, or of a file beside it, that is running."""
        for frame, line in walk_stack(sys._getframe(1)):
            name = frame.f_code.co_filename
            if Path(name).is_absolute() and Path(name).is_relative_to(cls.folder):
                return name, line
        return "", 0


class Named(str):
    """A name, which a scene reads as text or as data."""

    value = property(str)


class Data(Attributes):
    """A field of a component or node, as a scene reads, writes and links it."""

    _METHODS: ClassVar[dict[str, Callable]] = {
        "getLinkPath": lambda data: data.linkpath, "getName": lambda data: data.label,
        "getOwner": lambda data: data.owner, "getValueString": lambda data: str(data),
        "toList": lambda data: data.array.tolist(),
        **dict.fromkeys(("setParent", "setValue"), lambda data, value: setattr(data, "value", value)),
    }  # fmt: skip

    def __init__(self, owner: Any, name: str):
        """Makes it.

        Args:
            owner: Its component or node.
            name: Its name.
        """
        self.__dict__.update(owner=owner, label=name)

    linkpath = property(lambda self: f"@{self.owner.path}.{self.label}")
    array = property(lambda self: np.atleast_1d(np.asarray(() if self.value is None else self.value)))

    @property
    def value(self) -> Any:
        """Its value: numbers of a text or list as an array."""
        if isinstance(self.owner, SceneNode):
            return _as_read(self.owner.fields.get(self.label))
        try:
            # Most scenes read nothing, and it imports scipy and numba.
            from softrobot_twin.conversion.computed_values import value_of

            return _as_read(value_of(self.owner, self.label))
        except (NotConverted, RecursionError, ValueError, IndexError):
            return None

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "value":
            self.owner.fields[self.label] = recorded(value)

    def _attribute(self, name: str) -> Any:
        if not hasattr(self.value, name):
            Recorder.note_unknown(f"{self.label}.{name}")
        return getattr(self.value, name, Nothing())

    def __getitem__(self, index: Any) -> Any:
        return self.value[index]

    def __setitem__(self, index: Any, value: Any) -> None:
        array = self.array.astype(object)
        array[index] = value
        self.value = array

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return np.asarray(self.value, dtype=dtype)


_CONVERSIONS: dict[str, Callable[[np.ndarray], Any]] = {
    "len": len, "iter": iter, "float": lambda array: float(array.flat[0]),
    "bool": lambda array: bool(array.astype(object).any()), "str": lambda array: " ".join(map(str, array.flat)),
}  # fmt: skip
for _name, _convert in _CONVERSIONS.items():
    setattr(Data, f"__{_name}__", lambda self, _convert=_convert: _convert(self.array))


def _as_read(value: Any) -> Any:
    """A value as a scene reads it: lists and texts of numbers as arrays."""
    try:
        if isinstance(value, str) and " " in value and not is_link(value):
            return numbers(value)
        return np.asarray(value, float) if isinstance(value, list) else value
    except (NotConverted, ValueError, TypeError):
        return value


def recorded(value: Any) -> Any:
    """A value as it is kept; data, components and nodes stay what they are, as links.

    Args:
        value: What the scene gives.
    """
    if isinstance(value, Nothing):
        return UNKNOWN
    if isinstance(value, list | tuple | range | map):
        return [recorded(part) for part in value]
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


class _Owner(Attributes):
    """What nodes and components share; `_METHODS` are those of a scene's interface."""

    linkpath = property(lambda self: f"@{self.path}")
    _METHODS: ClassVar[dict[str, Callable]] = {
        "getLinkPath": lambda one: one.linkpath, "getPathName": lambda one: one.path,
        "getName": lambda one: str(one.name), "getContext": lambda one: one.node,
        "getClassName": lambda one: one.kind,
        **dict.fromkeys(("findData", "getData"), lambda one, name: Data(one, name)),
        **dict.fromkeys(("init", "reinit", "bwdInit", "addLink"), lambda one, *given, **more: None),
        "addData": lambda one, *given, **more: _add_data(one, *given, **more),
        "addNewData": lambda one, name, group, text, kind, value=None: _add_data(one, name, value),
        "getRoot": root_of, "getMechanicalState": lambda node: first(node, KINDS["states"]),
        "getChild": lambda node, name: next((one for one in node.children if one.name == name), None),
        "getObject": lambda node, name, *given: _object_at(node, name), "isInitialized": lambda node: False,
        "hasObject": lambda node, name: _object_at(node, name) is not None,
        "removeObject": lambda node, one: node.components.remove(one) if one in node.components else None,
        "removeChild": lambda node, child: (node.children.remove(child), child.parents.remove(node)),
    }  # fmt: skip


def _add_data(owner: Any, name: Any = None, value: Any = None, **more: Any) -> Data:
    """Adds a field to a node or component."""
    if isinstance(name, Data):
        name, value = name.label, name
    owner.fields[str(name)] = recorded(value)
    return Data(owner, str(name))


def _object_at(node: Any, path: str) -> Any:
    """The component at a path below a node; None where there is none."""
    *nodes, last = path.removeprefix("@").removeprefix("/").split("/")
    for step in nodes:
        node = next((one for one in node.children if one.name == step), None) if node is not None else None
    return None if node is None else next((one for one in node.components if one.name == last), None)


class Component(_Owner, SceneComponent):
    """A component, whose attributes are its fields."""

    _OWN = ("kind", "name", "node", "fields", "place", "read", "loaded")

    def _attribute(self, name: str) -> Any:
        return Data(self, name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self._OWN and not (name == "name" and "fields" in self.__dict__):
            object.__setattr__(self, name, value)
        else:
            self.fields[name] = recorded(value)


class Node(_Owner, SceneNode):
    """A node, whose attributes are its children, components and fields."""

    _OWN = ("name", "fields", "parents", "children", "components", "__dict__")
    objects = property(lambda self: self.components)

    def __init__(self, name: Any = "node", parent: Node | None = None, **fields: Any):
        """Makes it.

        Args:
            name: Its name.
            parent: The node above it.
            **fields: Its fields.
        """
        SceneNode.__init__(self, Named(getattr(name, "value", name)), fields)
        if parent is not None:
            parent.addChild(self)

    def addChild(self, child: Any, **fields: Any) -> Any:
        """Adds a node below this one.

        Args:
            child: The node, or a name for a new one.
            **fields: Fields of a new one.
        """
        if isinstance(child, Nothing):
            return child
        if not isinstance(child, Node):
            child = Node(str(child), **{key: recorded(value) for key, value in fields.items()})
        if child not in self.children:
            self.children.append(child)
            child.parents.append(self)
        return child

    def addObject(self, kind: Any, **fields: Any) -> Any:
        """Adds a component.

        Args:
            kind: Its kind, or a controller.
            **fields: Its fields.
        """
        if isinstance(kind, Controller):
            events = [name for name in dir(kind) if name.startswith("on") and name.endswith("Event")]
            self.addObject("Controller", name=type(kind).__name__, events=events)
        elif isinstance(kind, Component) and kind not in self.components:
            self.components.append(kind)
        if not isinstance(kind, str):
            return kind
        name = fields.pop("name", None) or kind
        made = Component(kind, Named(getattr(name, "value", name)), self,
                         {key: self._bound(recorded(value)) for key, value in fields.items()}, Recorder.place())
        self.components.append(made)
        return made

    createChild, createObject = addChild, addObject

    def __enter__(self) -> Node:
        return self

    def __exit__(self, *given: Any) -> None:
        """Nothing: a node that a block fills stays what it is."""

    def _bound(self, value: Any) -> Any:
        """A link from the top as what it leads to: a node may get other nodes above it later."""
        if isinstance(value, list):
            return [self._bound(part) for part in value]
        try:
            is_whole = isinstance(value, str) and value.startswith("@/")
            owner, label = follow(value, self) if is_whole else (value, None)
        except NotConverted:
            return value
        return owner if label is None else Data(owner, label)

    def add(self, thing: Any, *given: Any, **fields: Any) -> Any:
        """Adds a component by its kind, or what a function adds.

        Args:
            thing: The kind or the function.
            *given: Arguments of the function.
            **fields: Fields, or arguments.
        """
        return self.addObject(thing, **fields) if isinstance(thing, str) else thing(self, *given, **fields)

    def _attribute(self, name: str) -> Any:
        found = named(self, name)
        if found is not None:
            return found
        if name in self.fields or name in ("dt", "gravity", "animate", "time", "bbox"):
            return Data(self, name)
        raise AttributeError(f"{self.path} has no {name}")

    def __getitem__(self, path: str) -> Any:
        found: Any = self
        for step in path.replace("/", ".").split("."):
            found = getattr(found, step)
        return found

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self._OWN or isinstance(value, Node | Component) or callable(value) or name in self.__dict__:
            object.__setattr__(self, name, value)
        else:
            self.fields[name] = recorded(value)


class Controller(Attributes):
    """A component that is written in Python; its steps do not run, and its data are nothing."""

    def __init__(self, *given: Any, **more: Any):
        """Keeps the values as attributes.

        Args:
            *given: Not read.
            **more: Values.
        """
        self.__dict__.update(more)


class Prefab(Node):
    """A node that a class fills; its parameters are in lists of the class."""

    def __init__(self, *given: Any, **more: Any):
        """Sets the parameters and fills the node.

        Args:
            *given: A node that it is added to, perhaps.
            **more: Values of the parameters.
        """
        usual = {one["name"]: one.get("default") for name in ("properties", "prefabParameters", "prefabData")
                 for one in getattr(type(self), name, ())}  # fmt: skip
        values = usual | {key: value for key, value in more.items() if value is not None}
        name = values.pop("name", None) or type(self).__name__
        super().__init__(name, **{key: recorded(value) for key, value in values.items()})
        for parent in given:
            if isinstance(parent, Node):
                parent.addChild(self)
        self.init()
