"""Stand-ins of what SOFA's Python modules offer a scene: nodes, components, their data, controllers."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from softrobot_twin.conversion.scene_tree import (
    NotConverted,
    SceneComponent,
    SceneNode,
    UNKNOWN,
    above,
    first,
    follow,
    is_link,
    named,
    numbers,
    root_of,
)


class Nothing:
    """Stands for what nothing is known of: every attribute, call and sum of it is nothing."""

    def __init__(self, *given: Any, **named: Any):
        """Accepts everything.

        Args:
            *given: Not read.
            **named: Not read.
        """

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return Nothing()

    def __call__(self, *given: Any, **named: Any) -> Nothing:
        # A decorator gives back what it decorates.
        return given[0] if len(given) == 1 and not named and callable(given[0]) else Nothing()

    def __getitem__(self, index: Any) -> Nothing:
        return Nothing()

    def __setitem__(self, index: Any, value: Any) -> None:
        pass

    def __iter__(self) -> Iterator:
        return iter(())

    def __len__(self) -> int:
        return 0

    def __bool__(self) -> bool:
        return False

    def __float__(self) -> float:
        return 0.0

    def __int__(self) -> int:
        return 0

    def __enter__(self) -> Nothing:
        return self

    def __exit__(self, *raised: Any) -> None:
        pass

    def __str__(self) -> str:
        return ""

    def _same(self, other: Any = None) -> Any:
        return other

    __add__ = __radd__ = __sub__ = __rsub__ = __mul__ = __rmul__ = __truediv__ = __rtruediv__ = _same

    def __neg__(self) -> Nothing:
        return self


class Recorder:
    """What all stand-ins share: where the scene is, and how values are computed.

    Attributes:
        folder: Folder of the scene.
        value_of: `computed_values.value_of`.
    """

    folder: Path
    value_of: Callable[..., Any]

    @classmethod
    def place(cls) -> tuple[str, int]:
        """File and line of the scene that is running; of a file beside it where one calls another."""
        frame, last = sys._getframe(1), ("", 0)
        while frame is not None:
            name = frame.f_code.co_filename
            if not last[0] and Path(name).is_absolute() and Path(name).is_relative_to(cls.folder):
                last = (name, frame.f_lineno)
            frame = frame.f_back  # type: ignore[assignment]
        return last


class Named(str):
    """A name, which a scene reads as text or as data."""

    @property
    def value(self) -> str:
        """The text."""
        return str(self)

    getValueString = value


class Data:
    """A field of a component or node, as a scene reads, writes and links it."""

    def __init__(self, owner: Any, name: str):
        """Makes it.

        Args:
            owner: Its component or node.
            name: Its name.
        """
        self.__dict__.update(owner=owner, label=name)

    @property
    def value(self) -> Any:
        """Its value: numbers of a text or list as an array."""
        if isinstance(self.owner, SceneNode):
            found = self.owner.fields.get(self.label)
        else:
            try:
                found = Recorder.value_of(self.owner, self.label)
            except NotConverted:
                found = None
        return _as_read(found)

    @value.setter
    def value(self, value: Any) -> None:
        self.owner.fields[self.label] = recorded(value)

    array = property(lambda self: np.atleast_1d(np.asarray(self.value)))

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "value":
            self.owner.fields[self.label] = recorded(value)

    @property
    def linkpath(self) -> str:
        """Its link."""
        return f"@{self.owner.path}.{self.label}"

    def getLinkPath(self) -> str:
        """Its link."""
        return self.linkpath

    def getName(self) -> str:
        """Its name."""
        return self.label

    def getOwner(self) -> Any:
        """Its component or node."""
        return self.owner

    def getValueString(self) -> str:
        """Its value as text."""
        value = self.value
        return " ".join(map(str, np.ravel(value))) if isinstance(value, np.ndarray) else str(value)

    def setParent(self, other: Any) -> None:
        """Links it to other data.

        Args:
            other: The other data.
        """
        self.owner.fields[self.label] = recorded(other)

    def writeableArray(self) -> WriteableArray:
        """A context in which its numbers are written."""
        return WriteableArray(self)

    writeable = writeableArray

    def toList(self) -> list:
        """Its numbers."""
        return np.asarray(self.value).tolist()

    tolist = toList

    def __array__(self, dtype=None, copy=None) -> np.ndarray:
        return np.asarray(self.value, dtype=dtype)

    def __getitem__(self, index: Any) -> Any:
        return self.value[index]

    def __setitem__(self, index: Any, value: Any) -> None:
        array = np.atleast_1d(np.array(self.value, dtype=object if self.value is None else None))
        array[index] = value
        self.value = array

    def __len__(self) -> int:
        return 0 if self.value is None else len(np.atleast_1d(self.value))

    def __bool__(self) -> bool:
        value = self.value
        return bool(len(value)) if isinstance(value, np.ndarray | list | str) else bool(value)

    def __iter__(self) -> Iterator:
        return iter(() if self.value is None else np.atleast_1d(self.value))

    def __float__(self) -> float:
        return float(np.ravel(self.value)[0])

    def __str__(self) -> str:
        return self.getValueString()

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.value, name) if hasattr(self.value, name) else Nothing()


class WriteableArray:
    """Writes the numbers of data at the end of a ``with`` section."""

    def __init__(self, data: Data):
        """Makes it.

        Args:
            data: The data.
        """
        self.data = data

    def __enter__(self) -> np.ndarray:
        value = self.data.value
        self.array = np.array(np.zeros((1, 3)) if value is None else value)
        return self.array

    def __exit__(self, *raised: Any) -> None:
        self.data.value = self.array


def _as_read(value: Any) -> Any:
    """A value as a scene reads it: lists and texts of numbers as arrays."""
    if isinstance(value, list) or (isinstance(value, str) and not is_link(value) and " " in value):
        try:
            return np.asarray(value, float) if isinstance(value, list) else numbers(value)
        except (NotConverted, ValueError, TypeError):
            return value
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


class _Owner:
    """What nodes and components share."""

    fields: dict[str, Any]

    @property
    def linkpath(self) -> str:
        """Its link."""
        return f"@{self.path}"  # type: ignore[attr-defined]

    def getLinkPath(self) -> str:
        """Its link."""
        return self.linkpath

    def getPathName(self) -> str:
        """Its path."""
        return self.path  # type: ignore[attr-defined]

    def getName(self) -> str:
        """Its name."""
        return str(self.name)  # type: ignore[attr-defined]

    def findData(self, name: str) -> Data:
        """A field.

        Args:
            name: Its name.
        """
        return Data(self, name)

    getData = findData

    def addData(self, name: Any = None, value: Any = None, **more: Any) -> Data:
        """Adds a field.

        Args:
            name: Its name.
            value: Its value.
            **more: Its type and help; not read.
        """
        if not isinstance(name, Data):
            self.fields[str(name)] = recorded(value)
            return Data(self, str(name))
        self.fields[name.label] = recorded(name)
        return name

    def addNewData(self, name: str, group: str, text: str, kind: str, value: Any = None) -> Data:
        """Adds a field.

        Args:
            name: Its name.
            group: Not read.
            text: Not read.
            kind: Not read.
            value: Its value.
        """
        return self.addData(name, value)

    def init(self, *given: Any) -> None:
        """Nothing: values are computed when they are read.

        Args:
            *given: Not read.
        """

    def reinit(self) -> None:
        """As `init`."""

    bwdInit = reinit
    addLink = init


class Component(_Owner, SceneComponent):
    """A component, whose attributes are its fields."""

    _OWN = ("kind", "name", "node", "fields", "place", "read", "loaded")

    def getContext(self) -> SceneNode:
        """Its node."""
        return self.node

    def getClassName(self) -> str:
        """Its kind."""
        return self.kind

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in self._OWN:
            raise AttributeError(name)
        return Data(self, name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in self._OWN and not (name == "name" and "fields" in self.__dict__):
            object.__setattr__(self, name, value)
        else:
            self.fields[name] = recorded(value)


class Node(_Owner, SceneNode):
    """A node, whose attributes are its children, components and fields."""

    _OWN = ("name", "fields", "parents", "children", "components", "__dict__")

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

    def addChild(self, child: Any, **fields: Any) -> Node:
        """Adds a node below this one.

        Args:
            child: The node, or a name for a new one.
            **fields: Fields of a new one.
        """
        if not isinstance(child, Node):
            if isinstance(child, Nothing):
                return child  # type: ignore[return-value]
            child = Node(str(child), **{key: recorded(value) for key, value in fields.items()})
        if child not in self.children:
            self.children.append(child)
            child.parents.append(self)
        return child

    createChild = addChild

    def addObject(self, kind: Any, **fields: Any) -> Any:
        """Adds a component.

        Args:
            kind: Its kind, or a controller.
            **fields: Its fields.
        """
        if isinstance(kind, Nothing):
            return kind
        if not isinstance(kind, str):
            if not isinstance(kind, Controller):
                if isinstance(kind, Component) and kind not in self.components:
                    self.components.append(kind)
                return kind
            events = [name for name in dir(type(kind)) if name.startswith("on") and name.endswith("Event")]
            made = Component("Controller", Named(type(kind).__name__), self, {"events": events}, Recorder.place())
            self.components.append(made)
            return kind
        name = Named(getattr(fields.get("name"), "value", fields.pop("name", kind) or kind))
        fields.pop("name", None)
        made = Component(kind, name, self,
                         {key: self._bound(recorded(value)) for key, value in fields.items()}, Recorder.place())
        self.components.append(made)
        return made

    createObject = addObject

    def _bound(self, value: Any) -> Any:
        """A link from the top as what it leads to: a node may get other nodes above it later."""
        if isinstance(value, list):
            return [self._bound(part) for part in value]
        if not isinstance(value, str) or not value.startswith("@/"):
            return value
        try:
            owner, label = follow(value, self)
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

    def removeChild(self, child: Any) -> None:
        """Removes a node.

        Args:
            child: The node.
        """
        self.children[:] = [one for one in self.children if one is not child]
        if isinstance(child, Node):
            child.parents[:] = [one for one in child.parents if one is not self]

    def moveChild(self, child: Any, *parent: Any) -> None:
        """Moves a node below this one.

        Args:
            child: The node.
            *parent: Where it was; not read.
        """
        for above in list(child.parents):
            above.removeChild(child)
        self.addChild(child)

    def removeObject(self, component: Any) -> None:
        """Removes a component.

        Args:
            component: The component.
        """
        self.components[:] = [one for one in self.components if one is not component]

    def getRoot(self) -> SceneNode:
        """The node at the top."""
        return root_of(self)

    def getChild(self, name: Any, *warn: Any) -> Any:
        """The child of a name or number; None where there is none.

        Args:
            name: Its name or number.
            *warn: Not read.
        """
        if isinstance(name, int):
            return self.children[name]
        return next((one for one in self.children if one.name == name), None)

    def getObject(self, name: str, *warn: Any, **named: Any) -> Any:
        """The component at a path; None where there is none.

        Args:
            name: Its name or path.
            *warn: Not read.
            **named: Not read.
        """
        node: Any = self
        *nodes, last = name.removeprefix("@").removeprefix("/").split("/")
        for step in nodes:
            node = None if node is None else node.getChild(step)
        return None if node is None else next((one for one in node.components if one.name == last), None)

    def hasObject(self, name: str) -> bool:
        """Whether there is a component of a name.

        Args:
            name: The name.
        """
        return self.getObject(name) is not None

    def getMechanicalState(self) -> Any:
        """Its state."""
        return first(self, ("MechanicalObject",))

    @property
    def objects(self) -> list:
        """Its components."""
        return self.components

    def getRootPath(self) -> str:
        """Path up to the root."""
        return "/".join([".."] * max(1, len(list(above(self))) - 1))

    def isInitialized(self) -> bool:
        """False: nothing is simulated."""
        return False

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name in self._OWN:
            raise AttributeError(name)
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
        if name in self._OWN or isinstance(value, Node | Component) or callable(value):
            object.__setattr__(self, name, value)
        elif name in self.__dict__:
            self.__dict__[name] = value
        else:
            self.fields[name] = recorded(value)


class Controller:
    """A component that is written in Python; its steps do not run."""

    def __init__(self, *given: Any, **named: Any):
        """Keeps the values as attributes.

        Args:
            *given: Not read.
            **named: Values.
        """
        self.__dict__.update(named)

    def addData(self, *given: Any, **named: Any) -> Any:
        """Accepts a field.

        Args:
            *given: Name and value.
            **named: Name and value.
        """
        name = named.get("name", given[0] if given else "data")
        self.__dict__[str(name)] = Nothing()
        return self.__dict__[str(name)]

    addNewData = addLink = addData

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        return Nothing()


class Prefab(Node):
    """A node that a class fills; its parameters are in lists of the class."""

    def __init__(self, *given: Any, **named: Any):
        """Sets the parameters and fills the node.

        Args:
            *given: A node that it is added to, perhaps.
            **named: Values of the parameters.
        """
        parameters = [one for name in ("properties", "prefabParameters", "prefabData")
                      for one in getattr(type(self), name, ())]  # fmt: skip
        usual = {one["name"]: one.get("default") for one in parameters}
        given_name = named.pop("name", None) or usual.pop("name", None) or type(self).__name__
        super().__init__(given_name, **{key: recorded(value) for key, value in (usual | named).items()})
        for parent in given:
            if isinstance(parent, Node):
                parent.addChild(self)
        self.init()
