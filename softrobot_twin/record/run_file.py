"""The file of a run: MCAP with a channel for each topic, and one of JSON for everything else.

Each message of a topic is in CDR, as ROS sends it, with its definition: Foxglove, ``ros2 bag`` and
other tools read them. The JSON channel holds what a replay needs, numbered without gaps: the
description of the run, each call of the loop, and each tick with its results. Its JSON is the text
of a `std_msgs/String`, because ``ros2 bag`` refuses a file in which any channel is not in CDR. A
file that ends in the middle, because the process was killed, is read up to its last complete chunk.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any, NamedTuple

from softrobot_twin.errors import NamedError, one_line
from softrobot_twin.record.run_description import RunDescription

SUFFIX = ".mcap"
FORMAT = 2
"""Number of the format of the JSON channel; a file of another one is refused."""
SCHEMA = "softrobot_twin.RunEntry"
"""What the metadata of the JSON channel say that its texts are."""
TEXT, TEXT_DEFINITION = "std_msgs/msg/String", b"string data\n"
"""Type of the messages of the JSON channel, and its definition."""
RUN, CALL, TICK, END = "run", "call", "tick", "end"
"""Kinds of entries of the JSON channel."""
CHUNK_SIZE = 256 * 1024
"""Bytes of a chunk before it is compressed."""
_ENCAPSULATION = b"\x00\x01\x00\x00"
"""Begin of a message in CDR of version 1, little-endian, without options."""
INSTALL = "mcap is not installed: pip install mcap"

_JSON_SCHEMA = {
    "type": "object",
    "title": SCHEMA,
    "properties": {
        "kind": {"type": "string", "enum": [RUN, CALL, TICK, END]},
        "tick": {"type": "integer", "description": "number of the tick, from 0"},
        "now": {"type": "number", "description": "time of the tick on a monotonic clock [s]"},
        "ros_time": {"type": "integer", "description": "the same on the clock of the stamps [ns]"},
        "clock": {"type": "array", "items": {"type": "number"},
                  "description": "readings of the clock in the step [s]"},
        "values": {"type": "object", "description": "results of the tick, SI units; NaN is null"},
        "to": {"type": "string", "description": "input or service of the loop"},
        "arguments": {"type": "array"},
    },
}  # fmt: skip


class RunFileError(NamedError):
    """A file of a run, which the error names, cannot be used."""


def text_to_cdr(text: str) -> bytes:
    """A text as a serialized `std_msgs/String`.

    Args:
        text: The text.
    """
    content = text.encode() + b"\0"
    return _ENCAPSULATION + struct.pack("<I", len(content)) + content


def text_of_cdr(data: bytes) -> str:
    """The text of a serialized `std_msgs/String`, the inverse of `text_to_cdr`.

    Args:
        data: The bytes of the message.
    """
    return data[len(_ENCAPSULATION) + 4 : -1].decode()


class Topic(NamedTuple):
    """A topic of ROS.

    Attributes:
        name: Its full name.
        type_name: Type of its messages, such as ``geometry_msgs/msg/PointStamped``.
        definition: Their definition, with those of the types inside it.
        direction: ``in`` or ``out``.
    """

    name: str
    type_name: str
    definition: str
    direction: str


class RunWriter:
    """Writes a file of a run. Its parent folder is made; an existing file is kept.

    Raises:
        RunFileError: mcap is not installed, the file exists or cannot be written.
    """

    def __init__(self, path: Path, channel: str):
        """Opens the file.

        Args:
            path: The file.
            channel: Topic of the JSON channel.
        """
        try:
            from mcap.writer import Writer
        except ImportError:
            raise RunFileError(path, INSTALL) from None
        try:
            if path.exists():
                raise RunFileError(path, "exists already; move it away, or name another file")
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: IO[bytes] = path.open("xb")
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise RunFileError(path, f"cannot be written: {reason}") from None
        # With a checksum of all that stands before the index, not of messages alone.
        self._writer = Writer(self._file, chunk_size=CHUNK_SIZE, enable_data_crcs=True)
        self._writer.start(profile="ros2", library="softrobot_twin")
        schema = self._writer.register_schema(TEXT, "ros2msg", TEXT_DEFINITION)
        self._entries = self._writer.register_channel(
            channel, "cdr", schema, {"content": SCHEMA, "jsonschema": json.dumps(_JSON_SCHEMA)}
        )
        self._schemas = {TEXT: schema}
        self._channels: dict[str, tuple[int, int]] = {}

    def begin(self, description: RunDescription) -> None:
        """Writes the description, for a replay and, as attachment and metadata, for other tools.

        Args:
            description: The description.
        """
        began = description.began
        self._writer.add_attachment(
            began, began, Path(description.scene_path).name, "application/yaml",
            description.scene_text.encode(),
        )  # fmt: skip
        parameters = {name: json.dumps(value) for name, value in description.parameters.items()}
        self._writer.add_metadata("parameters", parameters)
        self._writer.add_metadata("machine", description.machine)
        self.add_entry(0, began, {"kind": RUN, "format": FORMAT, **asdict(description)})
        self.flush()

    def add_entry(self, sequence: int, time: int, content: dict[str, Any]) -> None:
        """Writes an entry of the JSON channel.

        Args:
            sequence: Its number, without gaps.
            time: When it happened [ns].
            content: It.
        """
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        self._writer.add_message(self._entries, time, text_to_cdr(text), time, sequence)

    def add_message(self, topic: Topic, time: int, data: bytes) -> None:
        """Writes a message.

        Args:
            topic: Its topic.
            time: When it came or went [ns].
            data: It, in CDR.
        """
        channel, count = self._channels.get(topic.name) or (self._channel_of(topic), 0)
        self._channels[topic.name] = channel, count + 1
        self._writer.add_message(channel, time, data, time, count)

    def _channel_of(self, topic: Topic) -> int:
        schema = self._schemas.get(topic.type_name)
        if schema is None:
            schema = self._writer.register_schema(topic.type_name, "ros2msg", topic.definition.encode())
            self._schemas[topic.type_name] = schema
        return self._writer.register_channel(topic.name, "cdr", schema, {"direction": topic.direction})

    def flush(self) -> None:
        """Ends the present chunk and gives all that was written to the system."""
        self._writer.flush()

    def abandon(self) -> None:
        """Closes the file without an index: what was written until now can be read."""
        with suppress(OSError):  # What the system could not write is lost in any case.
            self._file.close()

    def finish(self) -> None:
        """Writes the index and closes the file."""
        try:
            self._writer.finish()
        finally:
            self._file.close()


class Entry(NamedTuple):
    """An entry of the JSON channel.

    Attributes:
        sequence: Its number.
        time: When it happened [ns].
        content: It.
    """

    sequence: int
    time: int
    content: dict[str, Any]

    @property
    def kind(self) -> str:
        """Its kind."""
        return str(self.content.get("kind"))


class RunFile:
    """Reads a file of a run.

    Attributes:
        path: The file.
        description: What the run began with.
        is_complete: After `entries`: whether all entries are there, with the end of the run.
        damage: After `entries`: what is wrong in the file, up to its index; empty where nothing
            is. A complete run with damage has it where a replay does not read.
        lost: After `entries`: how many entries are missing, because they were dropped.
    """

    def __init__(self, path: Path | str):
        """Reads the description.

        Raises:
            RunFileError: The file cannot be read, or is not that of a run.
        """
        self.path = Path(path)
        self.is_complete, self.damage, self.lost = False, "", 0
        first = next(self._read(), None)
        if first is None or first.kind != RUN:
            why = f": {self.damage}" if self.damage else ""
            raise RunFileError(self.path, f"holds no run of a twin{why}")
        content = dict(first.content)
        content.pop("kind")
        found = content.pop("format", None)
        if found != FORMAT:
            raise RunFileError(self.path, f"is of format {found}, this version reads format {FORMAT}")
        try:
            self.description = RunDescription.from_json(content)
        except (KeyError, TypeError) as error:
            raise RunFileError(self.path, f"its description cannot be read: {error}") from None

    def entries(self) -> Iterator[Entry]:
        """All entries after the description, in their order, up to the first that is missing."""
        self.is_complete, self.damage, self.lost = False, "", 0
        expected = 0
        for entry in self._read():
            if entry.sequence != expected:
                self.lost = entry.sequence - expected
                return
            expected += 1
            if entry.kind == END:
                self.is_complete = True  # Reading goes on to the checksum of the file.
            elif entry.sequence:
                yield entry

    def _read(self) -> Iterator[Entry]:
        try:
            from mcap.records import Channel, Message
            from mcap.stream_reader import StreamReader
        except ImportError:
            raise RunFileError(self.path, INSTALL) from None
        try:
            file = self.path.open("rb")
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise RunFileError(self.path, f"cannot be read: {reason}") from None
        channels = set()
        with file:
            try:
                for record in StreamReader(file, validate_crcs=True).records:
                    if isinstance(record, Channel) and record.metadata.get("content") == SCHEMA:
                        channels.add(record.id)
                    elif isinstance(record, Message) and record.channel_id in channels:
                        content = json.loads(text_of_cdr(record.data))
                        yield Entry(record.sequence, record.log_time, content)
            except Exception as error:  # noqa: BLE001 - a damaged file raises anything
                self.damage = f"{type(error).__name__} {one_line(error)}".strip()
