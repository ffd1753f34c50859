"""Whose topics these are: only one twin may command the hardware on a topic.

Each twin says several times a second that it lives. A twin that crashed says nothing more, while the
middleware lists its publishers for another 20 s. Who says so without a publisher of commands is no
rival: the graph tells whose nodes can command.
"""

from __future__ import annotations

import json
import os
import re
import socket
import threading
import time
import uuid
from collections.abc import Callable
from typing import NamedTuple

from rclpy.node import Node
from rclpy.serialization import deserialize_message
from std_msgs.msg import String

from softrobot_twin.errors import printable
from softrobot_twin.ros.topics import CLAIM

BEAT_PERIOD = 0.2
"""Time from beat to beat [s]."""
LIFE_TIME = 1.0
"""A twin that was not heard for this time is dead [s]."""
_SAME_AGE = 1.0
"""Of twins whose ages differ by less [s], an order by name decides."""
_MOST_BYTES = 1000
"""A larger message is no beat, and is not read."""
_MOST_LETTERS, _GREATEST_AGE = 500, 1.0e9
"""Of a beat: most letters of its name, and greatest age [s]."""
MOST_RIVALS = 16
"""Rivals that are remembered; further ones are not heard until one of these is silent."""
_IS_IDENTITY = re.compile("[0-9a-f]{32}").fullmatch


class Rival(NamedTuple):
    """Another twin on the same topics.

    Attributes:
        heard: When it was heard last, on the monotonic clock [s].
        began: When it began, on this machine's monotonic clock [s].
        name: Its full name, its process and its machine.
        identity: Its own.
        is_enabled: Whether it publishes commands.
    """

    heard: float
    began: float
    name: str
    identity: str
    is_enabled: bool


class Beat(NamedTuple):
    """What a twin says of itself.

    Attributes:
        identity: Its own, 32 hexadecimal digits.
        name: Its full name, its process and its machine.
        age: Time since it began [s].
        is_enabled: Whether it publishes commands.
    """

    identity: str
    name: str
    age: float
    is_enabled: bool

    @classmethod
    def of(cls, text: str) -> Beat | None:
        """The beat that a text states; None where no twin can have written it.

        Args:
            text: The text.
        """
        try:
            beat = cls(*json.loads(text))
        except (ValueError, TypeError, RecursionError):
            return None
        identity, name, age, is_enabled = beat
        is_one = (
            isinstance(identity, str) and bool(_IS_IDENTITY(identity))
            and isinstance(name, str) and name.isprintable() and len(name) <= _MOST_LETTERS
            and isinstance(age, (int, float)) and 0.0 <= age <= _GREATEST_AGE
            and isinstance(is_enabled, bool)
        )  # fmt: skip
        return beat if is_one else None


class TopicClaim:
    """Claims a topic for a twin, and hears who else does.

    Args:
        node: The twin; its topics need not be open yet.
        topic: Full name of the topic of its commands.

    Attributes:
        name: Name of the twin, its process and its machine, as others show it.
        rivals: Other twins on it that were heard, by their identities.
    """

    def __init__(self, node: Node, topic: str):
        self.topic, self._node = topic, node
        self.is_enabled: Callable[[], bool] = lambda: False
        self.name = printable(f"{node.get_fully_qualified_name()} (process {os.getpid()} on "
                               f"{socket.gethostname()})")[:_MOST_LETTERS]  # fmt: skip
        self._identity, self._began = uuid.uuid4().hex, time.monotonic()
        self.rivals: dict[str, Rival] = {}
        # Neither is a topic of the run: they are not recorded.
        self._publisher = Node.create_publisher(node, String, f"{topic}/claim", CLAIM)
        self._subscription = Node.create_subscription(
            node, String, f"{topic}/claim", self.hear, CLAIM, raw=True
        )
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="claim", daemon=True)
        self._thread.start()

    def _beat(self) -> None:
        while not self._ends.wait(BEAT_PERIOD):
            age = time.monotonic() - self._began
            beat = Beat(self._identity, self.name, age, bool(self.is_enabled()))
            try:
                self._publisher.publish(String(data=json.dumps(beat)))
            except Exception:  # noqa: BLE001 - the node ends
                return

    def hear(self, content: bytes) -> None:
        """Hears a message; what is no beat is ignored.

        Args:
            content: The message, serialized.
        """
        if len(content) > _MOST_BYTES or self._identity.encode() in content:
            return  # It is no beat, or an own one.
        try:
            text = deserialize_message(content, String).data
        except Exception:  # noqa: BLE001 - whatever cannot be read is no beat
            return
        if (beat := Beat.of(text)) is None:
            return
        now = time.monotonic()
        self._forget_dead(now)
        if beat.identity in self.rivals or len(self.rivals) < MOST_RIVALS:
            self.rivals[beat.identity] = Rival(now, now - beat.age, beat.name, beat.identity, beat.is_enabled)

    def _forget_dead(self, now: float) -> None:
        self.rivals = {
            key: rival for key, rival in self.rivals.items() if now - rival.heard < LIFE_TIME
        }  # fmt: skip

    def listen(self) -> None:
        """Hears for `LIFE_TIME` who else lives and can command, where the graph knows of others.

        Called before the first tick, while no executor runs.
        """
        end = time.monotonic() + LIFE_TIME
        others = self._node.count_publishers(self.claimed_on) > 1
        while others and self.is_alone and time.monotonic() < end:
            taken = self._subscription.handle.take_message(String, True)
            if taken is None:
                time.sleep(0.02)
            else:
                self.hear(taken[0])

    @property
    def claimed_on(self) -> str:
        """Full name of the topic of the beats."""
        return self._subscription.topic_name

    @property
    def is_alone(self) -> bool:
        """Whether no other twin that can command on this topic lives."""
        return not self._living()

    def _living(self) -> list[Rival]:
        """The rivals that live, and whose nodes publish commands."""
        self._forget_dead(time.monotonic())
        if not self.rivals:
            return []
        nodes = [f"{one.node_namespace.rstrip('/')}/{one.node_name}"
                 for one in self._node.get_publishers_info_by_topic(self.topic)]  # fmt: skip
        own = self._node.get_fully_qualified_name()
        if own in nodes:
            nodes.remove(own)  # Another twin may have the same name.
        return [one for one in self.rivals.values() if one.name.partition(" ")[0] in nodes]

    def why_not(self) -> str:
        """Why this twin may not publish: another one has precedence; empty where none has.

        An enabled one has precedence before one that is not, then the older one; of twins that were
        started together, the one whose name and identity come first.
        """
        own = Rival(0.0, self._began, self.name, self._identity, bool(self.is_enabled()))
        for rival in self._living():
            if self.has_precedence(rival, own):
                return f"{self.topic} is commanded by {rival.name}: end one of both"
        return ""

    @staticmethod
    def has_precedence(rival: Rival, own: Rival) -> bool:
        """Whether the one of two comes first; of any two just one does.

        Args:
            rival: The one.
            own: The other.
        """
        if rival.is_enabled is not own.is_enabled:
            return rival.is_enabled
        if abs(rival.began - own.began) > _SAME_AGE:
            return rival.began < own.began
        return (rival.name, rival.identity) < (own.name, own.identity)

    def close(self) -> None:
        """Says nothing more."""
        self._ends.set()
        self._thread.join()
