"""Reads a SOFA scene in XML, ``.scn``: elements are components, or nodes below one another.

A document type is refused: its entities could fill the memory, or read other files.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.parsers import expat

from softrobot_twin.conversion.scene_tree import ConversionError, SceneComponent, SceneNode

LARGEST_FILE = 200_000_000
"""A larger file is refused [bytes]."""


def read_xml(path: Path) -> SceneNode:
    """The tree of a file.

    Args:
        path: The file.

    Raises:
        ConversionError: It is no XML, has a document type, or its root is no node.
    """
    reader = _Reader(path)
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise ConversionError(path, f"is larger than {LARGEST_FILE // 10**6} MB")
        reader.parser.Parse(path.read_bytes(), True)
    except OSError as error:
        raise ConversionError(path, error.strerror or str(error)) from error
    except expat.ExpatError as error:
        raise ConversionError(path, f"is no XML: {expat.errors.messages[error.code]}", error.lineno) from error
    return reader.root


class _Reader:
    """Builds the tree while the parser reads."""

    def __init__(self, path: Path):
        self.path, self.root = path, SceneNode("root", {"folder": str(path.resolve().parent)})
        self.open: list[SceneNode | None] = []
        self.parser = parser = expat.ParserCreate()
        parser.StartElementHandler, parser.EndElementHandler = self.start, self.end
        parser.StartDoctypeDeclHandler = self.refuse

    def refuse(self, *_) -> None:
        raise ConversionError(self.path, "has a document type (DOCTYPE), which may hold entities that "
                              "attack a reader: remove it", self.parser.CurrentLineNumber)  # fmt: skip

    def start(self, tag: str, given: dict[str, str]) -> None:
        parent = next((node for node in reversed(self.open) if node is not None), None)
        if tag == "Node":
            node = self.root if parent is None else SceneNode("node", parents=[parent])
            node.name = given.pop("name", node.name)
            node.fields |= given
            if parent is not None:
                parent.children.append(node)
            self.open.append(node)
            return
        if parent is None:
            raise ConversionError(self.path, f"begins with <{tag}>, not with <Node>: it is no scene",
                                  self.parser.CurrentLineNumber)  # fmt: skip
        given = {key: self.named(value, parent) for key, value in given.items()}
        kind = given.pop("type", tag) if tag == "Object" else tag
        parent.components.append(SceneComponent(
            kind, given.pop("name", kind), parent, dict(given),
            (str(self.path), self.parser.CurrentLineNumber)))  # fmt: skip
        self.open.append(None)

    @staticmethod
    def named(value: str, node: SceneNode) -> str:
        """A link by a name in place of one such as ``@[-1].indices``, to the component before."""
        found = re.match(r"@\[-(\d+)\](?=$|\.)", value)
        if found is None or int(found[1]) > len(node.components):
            return value
        before = node.components[-int(found[1])]
        if any(one.name == before.name for one in (*node.components, *node.children) if one is not before):
            before.name += f"_{len(node.components)}"
        return f"@{before.name}{value[found.end():]}"

    def end(self, tag: str) -> None:
        self.open.pop()
