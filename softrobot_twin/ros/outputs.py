"""What nodes publish in each tick: a table of topics, what is read for them, and their messages."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

from rclpy.node import Node
from rclpy.publisher import Publisher

from softrobot_twin.ros.topics import Topic, open_publisher


class Output(NamedTuple):
    """A topic of each object of a kind, which a node publishes in each tick.

    Attributes:
        topic: The topic.
        names: Names of the objects; nothing is opened without any.
        make: Makes a message of the values of an object and a header.
        read: Gives what a tick tells: the values of each object; nothing where it tells none.
        counts: How many numbers each value has, where a message tells nothing else; none where it
            must be made anew.
        has_it: Whether each object has it; None where all have.
        is_costly: Nothing is read where nobody receives it, also where the run is recorded.
    """

    topic: Topic
    names: Sequence[str]
    make: Callable[..., object]
    read: Callable[[Any], Sequence[tuple]]
    counts: Sequence[int] = ()
    has_it: Sequence[bool] | None = None
    is_costly: bool = False


def rows_of(*arrays: Iterable | None) -> list[tuple]:
    """The values of each object; nothing where an array is None.

    Args:
        *arrays: Values of each object, of one length; None where there are none.
    """
    return [] if any(array is None for array in arrays) else list(zip(*arrays, strict=True))


def open_outputs(
    node: Node, outputs: Iterable[Output], twin: str = ""
) -> list[tuple[Output, dict[int, Publisher]]]:
    """Opens the topics of outputs.

    Args:
        node: The node.
        outputs: The outputs.
        twin: Name of the twin, for topics of another node's twin.

    Returns:
        Each output that an object has, and publishers by the index of their object.
    """
    opened = []
    for output in outputs:
        has_it = (True,) * len(output.names) if output.has_it is None else output.has_it
        publishers = {index: open_publisher(node, output.topic, name, twin)
                      for index, name in enumerate(output.names) if has_it[index]}  # fmt: skip
        opened += [(output, publishers)] if publishers else []
    return opened
