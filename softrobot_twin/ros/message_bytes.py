"""Messages as bytes: arrays of markers without a Python object for each point, and few numbers.

A `geometry_msgs/Point` takes 2 µs to make and to convert, and a surface of 2000 triangles has 6000
of them: as long as a step of the simulation. rclpy also publishes bytes that are serialized
already, and the points of a message are then the bytes of an array. Of a command or a position only
the stamp and the numbers change from tick to tick. Received bytes are read here too: between two ticks
rclpy takes 0.12 ms for a point.
"""

from __future__ import annotations

import struct
from array import array
from collections import namedtuple
from collections.abc import Callable, Sequence
from copy import copy
from functools import cache, partial
from itertools import groupby
from typing import Any, NamedTuple

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Quaternion
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from softrobot_twin.control.loop_timing import NANOSECONDS
from softrobot_twin.ros.topics import class_named

# CDR of version 1, little-endian, without options (OMG DDSI-RTPS, section 10.5).
_ENCAPSULATION, _STAMP, _COUNT = b"\x00\x01\x00\x00", struct.Struct("<iI"), struct.Struct("<I")
_DOUBLE = np.dtype("<f8")
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


# What stands in a prototype where a message has what changes, in their order.
_MARK = Marker(
    header=Header(stamp=Time(sec=1_936_287_828, nanosec=1_886_221_359)),
    pose=Pose(position=Point(x=0.1, y=0.2, z=0.3), orientation=Quaternion(x=0.4, y=0.5, z=0.6, w=0.7)),
    color=ColorRGBA(r=0.1, g=0.2, b=0.3, a=0.4), points=[Point(x=0.8, y=0.9, z=1.1)],
    colors=[ColorRGBA(r=0.5, g=0.6, b=0.7, a=0.8)],
)  # fmt: skip
_ONE = struct.pack("<I", 1)


class MarkerBytes:
    """Serializes markers of which only stamps, poses, colours and points change.

    Args:
        prototypes: The markers, without points, colours of points and stamps.
        have_colours: Whether each of them has a colour for each point.
    """

    def __init__(self, prototypes: Sequence[Marker], have_colours: Sequence[bool]):
        marked = [copy(marker) for marker in prototypes]
        for marker, has_colours in zip(marked, have_colours, strict=True):
            marker.header = Header(stamp=_MARK.header.stamp, frame_id=marker.header.frame_id)
            marker.pose, marker.color, marker.points = _MARK.pose, _MARK.color, _MARK.points
            marker.colors = _MARK.colors if has_colours else []
        self._end = exact_bytes(MarkerArray(markers=marked))
        self._markers = [
            _Cut(*map(self._before, (_MARK.header.stamp, _MARK.pose, _MARK.color)),
                 self._before(_MARK.points[0]).rpartition(_ONE)[::2],
                 self._before(_MARK.colors[0]).removesuffix(_ONE) if has_colours else None,
                 _fields_of(marker.pose), _fields_of(marker.color))
            for marker, has_colours in zip(prototypes, have_colours, strict=True)
        ]  # fmt: skip

    def _before(self, mark: object) -> bytes:
        """Cuts what is left of the message at a mark; gives the piece before it.

        The lengths of what changes are multiples of 8 bytes, so that the padding of what follows
        does not depend on them.
        """
        piece, _, self._end = self._end.partition(_fields_of(mark))
        return piece

    def message(self, stamp: tuple[int, int], contents: Sequence[Content]) -> bytes:
        """A serialized `visualization_msgs/MarkerArray`.

        Args:
            stamp: Seconds and nanoseconds.
            contents: What changes of each marker, which has points, and a colour for each where it
                was announced with colours.
        """
        time, parts = _STAMP.pack(*stamp), []
        for cut, content in zip(self._markers, contents, strict=True):
            pose, colour = cut.pose, cut.colour
            if content.position is not None:
                pose = struct.pack("<7d", *content.position, *content.quaternion)
            if content.colour is not None:
                colour = struct.pack("<4f", *content.colour)
            size = struct.pack("<I", len(content.points))
            parts += [
                cut.before_stamp, time, cut.before_pose, pose, cut.before_colour, colour,
                size.join(cut.before_points), np.ascontiguousarray(content.points, "<f8").tobytes(),
            ]  # fmt: skip
            if cut.before_colours is not None:
                colours = np.ascontiguousarray(content.colours, "<f4").tobytes()
                parts += [cut.before_colours, size, colours]
        return b"".join([*parts, self._end])


def exact_bytes(message: object) -> bytes:
    """A message of numbers, texts and sequences in CDR, without bytes after its end.

    The middleware estimates the size of a message, and where an empty sequence of doubles stands in
    it, as `velocity` in a `sensor_msgs/JointState`, bytes without a meaning follow its end. Readers
    of bags that check the size refuse it.

    Args:
        message: The message.
    """
    return _ENCAPSULATION + _fields_of(message)


def to_bytes(message: object) -> bytes:
    """A message in CDR; one that is serialized already stays as it is.

    Args:
        message: The message, or its bytes.
    """
    if isinstance(message, bytes):
        return message
    return exact_bytes(message) if isinstance(message, JointState) else serialize_message(message)


_Read = Callable[[bytes, int], tuple[Any, int]]
"""Reads a value from bytes at a place; gives also the place behind it."""


def read_message(content: bytes, kind: type) -> tuple[Any, int]:
    """A message in CDR as a named tuple of its fields, in which those of messages are the same.

    Args:
        content: The message in CDR; bytes may follow its end.
        kind: Class of the message.

    Returns:
        The message, and how many bytes are its.

    Raises:
        ValueError: The bytes are no message of this kind.
    """
    begin = len(_ENCAPSULATION)
    if len(content) < begin or content[:2] != _ENCAPSULATION[:2]:
        raise ValueError("the message is not in CDR of version 1, little-endian")
    try:
        message, end = reader_of(kind)(content[begin:], 0)
    except struct.error as error:
        raise ValueError("the message ends too early") from error
    return message, begin + end


@cache
def reader_of(kind: type | str) -> _Read:
    """What reads a message, or a field of a kind as messages state them that is no number.

    Args:
        kind: Class of the message, or the kind.
    """
    if kind == "string":
        return _read_string
    if isinstance(kind, str) and kind.startswith("sequence<"):
        element = kind[len("sequence<") : -1]
        code = _NUMBERS.get(element, "")
        return partial(_read_sequence, code, None if code else reader_of(element))
    if isinstance(kind, str):
        kind = class_named(kind)
    fields, steps = kind.get_fields_and_field_types(), []
    make = namedtuple(kind.__name__, fields)._make
    # Numbers of one size that follow each other are read at once.
    for size, run in groupby(fields.values(), lambda field: struct.calcsize(_NUMBERS.get(field, ""))):
        if size:
            steps.append((size, struct.Struct("<" + "".join(map(_NUMBERS.__getitem__, run)))))
        else:
            steps += [(0, reader_of(field)) for field in run]

    def read(content: bytes, place: int) -> tuple[Any, int]:
        values: list = []
        for size, step in steps:
            if size:
                place += -place % size
                values += step.unpack_from(content, place)
                place += step.size
            else:
                value, place = step(content, place)
                values.append(value)
        return make(values), place

    return read


def _read_string(content: bytes, place: int) -> tuple[str, int]:
    letters, place = _read_sequence("B", None, content, place)
    return letters[:-1].tobytes().decode(errors="replace"), place  # Without the zero at its end.


def _read_sequence(code: str, read: _Read | None, content: bytes, place: int) -> tuple[Any, int]:
    """Reads numbers, which have a code, or elements that are read one by one."""
    place += -place % _COUNT.size
    (count,) = _COUNT.unpack_from(content, place)
    place += _COUNT.size
    if read is None:
        numbers = array(code)
        place += -place % numbers.itemsize if count else 0
        end = place + count * numbers.itemsize
        if end > len(content):
            raise ValueError("a sequence is longer than its message")
        numbers.frombytes(content[place:end])
        return numbers, end
    values = []
    for _ in range(count):
        value, place = read(content, place)
        values.append(value)
    return values, place


def stamped(content: bytes, stamp: int) -> bytes:
    """A message in CDR with another time [ns] in its header, its first field.

    Args:
        content: The message in CDR.
        stamp: The time [ns].
    """
    begin, time = len(_ENCAPSULATION), _STAMP.pack(*divmod(stamp, NANOSECONDS))
    return b"".join((content[:begin], time, content[begin + _STAMP.size :]))


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
        _STAMP.pack_into(self._content, len(_ENCAPSULATION), *divmod(stamp, NANOSECONDS))
        for place, values in zip(self._places, numbers, strict=True):
            place[:] = np.asarray(values, _DOUBLE).tobytes()
        return bytes(self._content)


class _Cut(NamedTuple):
    """Constant pieces of a marker, in their order, and the prototype's pose and colour.

    That before the points is two: before their number and after it.
    """

    before_stamp: bytes
    before_pose: bytes
    before_colour: bytes
    before_points: tuple[bytes, bytes]
    before_colours: bytes | None
    pose: bytes
    colour: bytes


def _fields_of(message: object) -> bytes:
    """The fields of a message one after the other, each aligned to its size."""
    content = bytearray()
    _write(content, type(message).__name__, message)
    return bytes(content)


def _write(content: bytearray, kind: str, value: Any) -> None:
    """Appends a field of a kind as messages state them: a number, a string, a message or a
    sequence."""
    if kind.startswith("sequence<"):
        _write(content, "uint32", len(value))
        for element in value:
            _write(content, kind[len("sequence<") : -1], element)
    elif kind == "string":
        encoded = value.encode() + b"\0"
        _write(content, "uint32", len(encoded))
        content += encoded
    elif kind in _NUMBERS:
        size = struct.calcsize(_NUMBERS[kind])
        content += bytes(-len(content) % size) + struct.pack(f"<{_NUMBERS[kind]}", value)
    else:
        for field, inner in value.get_fields_and_field_types().items():
            _write(content, inner, getattr(value, field))
