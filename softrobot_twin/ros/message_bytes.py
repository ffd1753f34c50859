"""Messages as bytes: arrays of markers without a Python object for each point, and few numbers.

A `geometry_msgs/Point` takes 2 µs to make and to convert, and a surface of 2000 triangles has 6000
of them: as long as a step of the simulation. rclpy also publishes bytes that are serialized
already, and the points of a message are then the bytes of an array. Of a command or a position only
the stamp and the numbers change from tick to tick.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from softrobot_twin.control.loop_timing import NANOSECONDS

# CDR of version 1, little-endian, without options (OMG DDSI-RTPS, section 10.5).
_ENCAPSULATION, _STAMP = b"\x00\x01\x00\x00", struct.Struct("<iI")
_NUMBERS = {
    "boolean": "?", "octet": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h",
    "uint32": "I", "int32": "i", "uint64": "Q", "int64": "q", "float": "f", "double": "d",
}  # fmt: skip


class Content(NamedTuple):
    """What changes of a marker from message to message.

    Attributes:
        points: Its points [m], shape (point_count, 3), at least one.
        colours: A colour for each point from 0 to 1, shape (point_count, 4); None where the marker
            has one colour.
        colour: The one colour, four numbers from 0 to 1; None for that of the prototype.
        position: Origin of its points in its frame [m], shape (3,); None for that of the prototype.
        quaternion: Rotation of its points (x, y, z, w), with `position`.
    """

    points: np.ndarray
    colours: np.ndarray | None = None
    colour: Sequence[float] | None = None
    position: np.ndarray | None = None
    quaternion: np.ndarray | None = None


class MarkerBytes:
    """Serializes markers of which only stamps, poses, colours and points change.

    Args:
        prototypes: The markers, without points, colours of points and stamps.
        have_colours: Whether each of them has a colour for each point.
    """

    def __init__(self, prototypes: Sequence[Marker], have_colours: Sequence[bool]):
        writer = _Writer()
        writer.number("uint32", len(prototypes))
        self._markers = [
            self._cut(writer, marker, has_colours)
            for marker, has_colours in zip(prototypes, have_colours, strict=True)
        ]
        self._end = writer.take()

    @staticmethod
    def _cut(writer: _Writer, marker: Marker, has_colours: bool) -> _Cut:
        """The constant pieces of a marker, between what changes.

        The lengths of what changes are multiples of 8 bytes, so that the padding of what follows
        does not depend on them.
        """
        pieces = {}
        for field, kind in marker.get_fields_and_field_types().items():
            if field == "header":
                writer.align(4)
                pieces["stamp"] = writer.take()
                writer.skip(8)
                writer.string(marker.header.frame_id)
            elif field in ("pose", "color"):
                writer.align(8 if field == "pose" else 4)
                pieces[field] = writer.take()
                writer.skip(56 if field == "pose" else 16)
            elif field == "points" or (field == "colors" and has_colours):
                writer.align(4)
                pieces[field] = writer.take()
                writer.skip(4)
                if field == "points":
                    pieces["padding"] = writer.align(8)
                    writer.take()
            else:
                writer.value(kind, getattr(marker, field))
        p, q, c = marker.pose.position, marker.pose.orientation, marker.color
        pose = struct.pack("<7d", p.x, p.y, p.z, q.x, q.y, q.z, q.w)
        return _Cut(pieces["stamp"], pieces["pose"], pieces["color"], pieces["points"],
                    pieces["padding"], pieces.get("colors"), pose,
                    struct.pack("<4f", c.r, c.g, c.b, c.a))  # fmt: skip

    def message(self, stamp: tuple[int, int], contents: Sequence[Content]) -> bytes:
        """A serialized `visualization_msgs/MarkerArray`.

        Args:
            stamp: Seconds and nanoseconds.
            contents: What changes of each marker.

        Raises:
            ValueError: A marker has no points, or colours that are not one for each point.
        """
        time, parts = struct.pack("<iI", *stamp), [_ENCAPSULATION]
        for cut, content in zip(self._markers, contents, strict=True):
            count = len(content.points)
            has_colours = cut.before_colours is not None
            if count == 0 or has_colours != (content.colours is not None):
                raise ValueError("a marker needs points, and colours as it was announced")
            pose, colour = cut.pose, cut.colour
            if content.position is not None:
                pose = struct.pack("<7d", *content.position, *content.quaternion)
            if content.colour is not None:
                colour = struct.pack("<4f", *content.colour)
            size = struct.pack("<I", count)
            parts += [
                cut.before_stamp, time, cut.before_pose, pose, cut.before_colour, colour,
                cut.before_points, size, cut.padding,
                np.ascontiguousarray(content.points, "<f8").tobytes(),
            ]  # fmt: skip
            if has_colours:
                if len(content.colours) != count:
                    raise ValueError("a marker needs one colour for each point")
                colours = np.ascontiguousarray(content.colours, "<f4").tobytes()
                parts += [cut.before_colours, size, colours]
        return b"".join([*parts, self._end])


def exact_bytes(message: object) -> bytes:
    """A message of numbers, texts and sequences in CDR, without bytes after its end.

    The middleware estimates the size of a message, and where an empty sequence of doubles stands in
    it, as `velocity` in a `sensor_msgs/JointState`, bytes without a meaning follow its end. Readers
    of bags that check the size refuse it.
    """
    writer = _Writer()
    for field, kind in message.get_fields_and_field_types().items():
        writer.value(kind, getattr(message, field))
    return _ENCAPSULATION + writer.take()


def to_bytes(message: object) -> bytes:
    """A message in CDR; one that is serialized already stays as it is."""
    if isinstance(message, bytes):
        return message
    return exact_bytes(message) if isinstance(message, JointState) else serialize_message(message)


def put_stamp(content: bytearray, stamp: int) -> None:
    """Writes a time [ns] into the header of a message in CDR, its first field."""
    _STAMP.pack_into(content, len(_ENCAPSULATION), *divmod(stamp, NANOSECONDS))


class MessageBytes:
    """Bytes of messages of one kind, made once: then only stamp and numbers change."""

    def __init__(self, make: Callable, frame_id: str, *counts: int):
        """Make a message.

        Args:
            make: Makes a message of arrays of numbers and a header, its first field.
            frame_id: Frame of its header.
            counts: How many numbers each array has.
        """
        # Numbers that tell where they lie in a message.
        marks = np.split(np.arange(1.0, 1.0 + sum(counts)), np.cumsum(counts[:-1]))
        self._content = bytearray(exact_bytes(make(*marks, Header(frame_id=frame_id))))
        found = ((self._content.index(mark.tobytes()), mark.nbytes) for mark in marks)
        # A view refuses numbers of another count.
        whole = memoryview(self._content)
        self._places = [whole[place : place + size] for place, size in found]

    def message(self, stamp: int, *numbers: np.ndarray | float) -> bytes:
        """A message with these numbers.

        Args:
            stamp: Its time [ns].
            numbers: The arrays, shape (count,) each.
        """
        put_stamp(self._content, stamp)
        for place, values in zip(self._places, numbers, strict=True):
            place[:] = np.asarray(values, "<f8").tobytes()
        return bytes(self._content)


class _Cut(NamedTuple):
    """Constant pieces of a marker, in their order, and the prototype's pose and colour."""

    before_stamp: bytes
    before_pose: bytes
    before_colour: bytes
    before_points: bytes
    padding: bytes
    before_colours: bytes | None
    pose: bytes
    colour: bytes


class _Writer:
    """Writes fields of messages one after the other, each aligned to its size."""

    def __init__(self) -> None:
        self._bytes, self._count = bytearray(), 0

    def take(self) -> bytes:
        """What was written since the last call."""
        taken = bytes(self._bytes)
        self._bytes.clear()
        return taken

    def skip(self, size: int) -> None:
        """Counts bytes that are not written here."""
        self._count += size

    def align(self, size: int) -> bytes:
        """Writes padding up to a multiple of a size; returns it."""
        padding = b"\0" * (-self._count % size)
        self._put(padding)
        return padding

    def number(self, kind: str, value: object) -> None:
        """Writes a number of a kind such as ``double``."""
        code = _NUMBERS[kind]
        self.align(struct.calcsize(code))
        self._put(struct.pack(f"<{code}", value))

    def string(self, text: str) -> None:
        """Writes a string with its length and a zero at its end."""
        encoded = text.encode() + b"\0"
        self.number("uint32", len(encoded))
        self._put(encoded)

    def value(self, kind: str, value: object) -> None:
        """Writes a field of a kind as messages state them: a number, a string, a message or a
        sequence."""
        if kind.startswith("sequence<"):
            self.number("uint32", len(value))
            for element in value:
                self.value(kind[len("sequence<") : -1], element)
        elif kind == "string":
            self.string(value)
        elif kind in _NUMBERS:
            self.number(kind, value)
        else:
            for field, inner in value.get_fields_and_field_types().items():
                self.value(inner, getattr(value, field))

    def _put(self, content: bytes) -> None:
        self._bytes += content
        self._count += len(content)
