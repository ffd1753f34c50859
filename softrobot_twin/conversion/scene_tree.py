"""The tree of a SOFA scene: nodes, their components, and links between them.

A value is as the file gives it: a number, a text, a list, or a link such as ``@../loader.position``.
`computed_values` follows links and computes what a component would.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from softrobot_twin.errors import SoftRobotTwinError

TABLE: dict[str, Any] = yaml.safe_load(Path(__file__).with_name("components.yaml").read_text(encoding="utf-8"))
"""What components of SOFA are here."""
KINDS: dict[str, tuple[str, ...]] = {key: tuple(kinds) for key, kinds in TABLE["kinds"].items()}
KINDS["elastic"] = KINDS["linear"] + KINDS["hyperelastic"]
KINDS["movers"] = KINDS["euler_implicit"] + KINDS["static"] + KINDS["other_motion"]
KINDS["meshes"] = KINDS["loaders"] + KINDS["topologies"]
"""Names of components by what they are here."""


class ConversionError(SoftRobotTwinError):
    """A file cannot be read as a scene.

    Attributes:
        path: The file.
        reason: What is wrong.
        line: Its line; None where none is known.
    """

    def __init__(self, path: Path | str, reason: str, line: int | None = None):
        self.path, self.reason, self.line = Path(path), reason, line
        super().__init__(f"{path}{'' if line is None else f':{line}'}: {reason}")


UNKNOWN = "(from a module that is not installed)"
"""Stands for a value that comes from a module that is not installed."""


class NotConverted(Exception):
    """A component, or one of its fields, has no counterpart; the text says why."""


@dataclass(eq=False)
class SceneComponent:
    """A component of a node.

    Attributes:
        kind: Name of its class, such as ``MechanicalObject``.
        name: Its own name, or its kind.
        node: Its node.
        fields: Values that the file gives, by name.
        place: File and line where it is made.
        read: Names of the fields that a conversion has read.
    """

    kind: str
    name: str
    node: SceneNode
    fields: dict[str, Any]
    place: tuple[str, int]
    read: set[str] = field(default_factory=set)

    @property
    def path(self) -> str:
        """Path from the root, as links have it."""
        return f"{self.node.path.rstrip('/')}/{self.name}"

    @property
    def where(self) -> str:
        """File and line, for messages."""
        return f"{Path(self.place[0]).name}:{self.place[1]}"


@dataclass(eq=False)
class SceneNode:
    """A node of the tree; with rigidified parts it has several parents.

    Attributes:
        name: Its name.
        fields: Values such as ``gravity`` and ``dt``, by name.
        parents: Nodes above it; the first one is meant by ``..``.
        children: Nodes below it.
        components: Its components, in the order of the file.
    """

    name: str
    fields: dict[str, Any] = field(default_factory=dict)
    parents: list[SceneNode] = field(default_factory=list)
    children: list[SceneNode] = field(default_factory=list)
    components: list[SceneComponent] = field(default_factory=list)

    @property
    def path(self) -> str:
        """Path from the root, as links have it."""
        return f"{self.parents[0].path.rstrip('/')}/{self.name}" if self.parents else "/"


# Functions, not methods: a scene may call its nodes ``first`` or ``root``.


def root_of(node: SceneNode) -> SceneNode:
    """The node at the top.

    Args:
        node: A node below it.
    """
    return root_of(node.parents[0]) if node.parents else node


def walk(node: SceneNode, seen: set[int] | None = None) -> Iterator[SceneNode]:
    """A node and all below it that are active, each once.

    Args:
        node: The node.
        seen: Identities of nodes that are left out.
    """
    seen = set() if seen is None else seen
    if id(node) in seen:
        return
    seen.add(id(node))
    yield node
    for child in node.children:
        if str(child.fields.get("activated", True)).lower() not in ("0", "false"):
            yield from walk(child, seen)


def components_below(node: SceneNode, kinds: Collection[str]) -> list[SceneComponent]:
    """The components of some kinds in a node and all below it, in the order of the tree.

    Args:
        node: The node.
        kinds: Names of classes.
    """
    return [one for below in walk(node) for one in below.components if one.kind in kinds]


def above(node: SceneNode) -> Iterator[SceneNode]:
    """A node and those above it, the nearest first, each once.

    Args:
        node: The node.
    """
    seen: list[SceneNode] = [node]
    for one in seen:
        yield one
        seen += [parent for parent in one.parents if parent not in seen]


def first(node: SceneNode, kinds: Collection[str]) -> SceneComponent | None:
    """The first component of a node that is of one of some kinds.

    Args:
        node: The node.
        kinds: Names of classes.
    """
    return next((one for one in node.components if one.kind in kinds), None)


def nearest(node: SceneNode, kinds: tuple[str, ...]) -> SceneComponent | None:
    """The first component of one of some kinds in a node or the nearest above it.

    Args:
        node: The node.
        kinds: Names of classes.
    """
    return next((found for one in above(node) if (found := first(one, kinds))), None)


def named(node: SceneNode, name: str) -> SceneNode | SceneComponent | None:
    """The component or child of a node that has a name.

    Args:
        node: The node.
        name: The name.
    """
    return next((one for one in (*node.components, *node.children) if one.name == name), None)


def is_link(value: Any) -> bool:
    """Whether a value is a link: a text, or while a file runs what it leads to.

    Args:
        value: Value of a field.
    """
    return value.startswith("@") if isinstance(value, str) else hasattr(value, "linkpath")


def follow(link: Any, node: SceneNode) -> tuple[SceneNode | SceneComponent, str | None]:
    """What a link leads to: a node or component, and perhaps a field of it.

    Args:
        link: Such as ``@../loader.position``.
        node: The node that it begins in.

    Raises:
        NotConverted: It leads nowhere.
    """
    if not isinstance(link, str):
        return (link, None) if isinstance(link, SceneNode | SceneComponent) else (link.owner, link.label)
    path = link.strip().removeprefix("@").removeprefix("./")
    here: SceneNode | SceneComponent = root_of(node) if path.startswith("/") else node
    steps = [step for step in path.split("/") if step not in ("", ".")]
    name: str | None = None
    for index, step in enumerate(steps):
        if step == "..":
            here = here.node if isinstance(here, SceneComponent) else (here.parents or [here])[0]
            continue
        found = named(here, step) if isinstance(here, SceneNode) else None
        if index == 0 and isinstance(here, SceneNode):
            # Without a path, nodes above are searched too.
            stem = step.rpartition(".")[0] or step
            here = next((one for one in above(here) if named(one, step) or named(one, stem)), here)
            found = named(here, step)
        if found is None and index == len(steps) - 1:
            stem, dot, name = step.rpartition(".")
            found = named(here, stem) if dot and isinstance(here, SceneNode) else None
            if found is None and isinstance(here, SceneNode) and step in here.fields:
                found, name = here, step
        if found is None:
            raise NotConverted(f"the link {link} leads nowhere")
        here = found
    return here, name


def numbers(value: Any, width: int = 1, may_be_infinite: bool = False) -> np.ndarray:
    """The numbers of a value, in rows.

    Args:
        value: A number, a list, or a text with numbers.
        width: Numbers in a row.
        may_be_infinite: Whether infinity, no limit, is a number too.

    Returns:
        Shape (count, width), or (count,) for a width of 1.

    Raises:
        NotConverted: It has something else.
    """
    if isinstance(value, str):
        value = re.split(r"[\s,;\[\]]+", value.strip(" \n\t[],;")) if value.strip() else []
    try:
        flat = np.asarray(_flat(value), dtype=float)
    except (TypeError, ValueError):
        raise NotConverted(f"{str(value)[:60]!r} is no list of numbers") from None
    if not (~np.isnan(flat) if may_be_infinite else np.isfinite(flat)).all():
        raise NotConverted(f"{str(value)[:60]!r} has what is infinite or no number")
    if width == 1:
        return flat
    if len(flat) % width:
        raise NotConverted(f"has {len(flat)} numbers, which make no rows of {width}")
    return flat.reshape(-1, width)


def _flat(value: Any) -> list[float]:
    if isinstance(value, list | tuple | np.ndarray):
        return [number for part in value for number in _flat(part)]
    return [float(value)]


def to_plain(root: SceneNode) -> dict:
    """A tree as what JSON can hold by `json_value`; `from_plain` makes the tree again.

    Args:
        root: The node at the top.
    """
    nodes = list(walk(root))
    index = {id(node): number for number, node in enumerate(nodes)}
    return {"nodes": [
        {"name": node.name, "fields": node.fields,
         "parents": [index[id(one)] for one in node.parents if id(one) in index],
         "components": [{"kind": one.kind, "name": one.name, "fields": one.fields,
                         "place": one.place} for one in node.components]}
        for node in nodes]}  # fmt: skip


def json_value(value: Any) -> Any:
    """A value that JSON has not, as one that it has.

    Args:
        value: An array, what stands for a link, or something else, whose text is taken.
    """
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return value.linkpath if is_link(value) else str(value)


def from_plain(plain: dict) -> SceneNode:
    """The root of the tree that `to_plain` wrote.

    Args:
        plain: What it returned.
    """
    nodes = [SceneNode(one["name"], one["fields"]) for one in plain["nodes"]]
    for node, one in zip(nodes, plain["nodes"], strict=True):
        node.parents = [nodes[number] for number in one["parents"]]
        for parent in node.parents:
            parent.children.append(node)
        node.components = [
            SceneComponent(part["kind"], part["name"], node, part["fields"], tuple(part["place"]))
            for part in one["components"]]  # fmt: skip
    return nodes[0]
