"""Who else is on a node's topics: two of one kind would take turns without knowing it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from rclpy.node import Node

_MOST_TOLD = 4
"""Names that one sentence lists at most."""


class Clash(NamedTuple):
    """Something that there should be one of and is not.

    Attributes:
        key: What it is about: a topic, or ``name``.
        sentence: What is so, and what to do.
        is_grave: True when it disturbs what goes to the hardware or comes from it.
    """

    key: str
    sentence: str
    is_grave: bool


class GraphWatch:
    """Counts, in the graph that the middleware keeps, who publishes on a node's topics.

    A query costs some microseconds a topic and no network. A node that died without leaving stays
    in the graph for some 20 s.

    Args:
        node: The node.
        grave: Full names of topics whose second publisher disturbs the hardware: those of commands
            to it and of what it measures.
        others: Full names of further topics that have one publisher.
    """

    def __init__(self, node: Node, grave: Sequence[str], others: Sequence[str] = ()):
        self._node = node
        self._topics = [(topic, True) for topic in grave] + [(topic, False) for topic in others]

    def clashes(self) -> list[Clash]:
        """What there is more than one of, now."""
        found = []
        own = (self._node.get_name(), self._node.get_namespace())
        names = self._node.get_node_names_and_namespaces()
        if (count := names.count(own)) > 1:
            name = self._node.get_fully_qualified_name()
            found.append(Clash("name", f"{count} nodes are called {name}: end all but one, or "
                               "rename one with -r __node:=NAME", True))
        for topic, is_grave in self._topics:
            if (count := self._node.count_publishers(topic)) > 1:
                found.append(Clash(topic, self._sentence(topic, count), is_grave))
        return found

    def _sentence(self, topic: str, count: int) -> str:
        publishers = self._node.get_publishers_info_by_topic(topic)
        names = sorted(
            f"{info.node_namespace.rstrip('/')}/{info.node_name}" for info in publishers
        )
        told = ", ".join(names[:_MOST_TOLD]) + (", …" if len(names) > _MOST_TOLD else "")
        return f"{count} publishers on {topic} ({told}): end all but one"
