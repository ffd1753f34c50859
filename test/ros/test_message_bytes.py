"""Messages as bytes against the same messages made as objects."""

import re
from functools import partial

import numpy as np
import pytest
from geometry_msgs.msg import PointStamped, PoseStamped, Vector3Stamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import FluidPressure
from std_msgs.msg import Header

from softrobot_twin.ros.message_bytes import MessageBytes, exact_bytes, read_message
from softrobot_twin.ros.messages import (
    READERS,
    cables_message,
    point_message,
    pose_message,
    pressure_message,
    stamp_of,
    vector_message,
)
from softrobot_twin.ros.topics import class_named, type_name


@pytest.mark.parametrize("count", [0, 1, 3, 4])
def test_joints_whose_numbers_change_have_the_bytes_of_a_message_made_anew(count):
    rng = np.random.default_rng(count)
    names = [f"cable_{'x' * k}" for k in range(count)]
    joints = MessageBytes(partial(cables_message, names), "base_link", count, count)
    for stamp in (0, 5, 1_700_000_000_987_654_321):
        positions, efforts = rng.standard_normal((2, count))
        header = Header(stamp=stamp_of(stamp), frame_id="base_link")
        made = cables_message(names, positions, efforts, header)
        assert joints.message(stamp, positions, efforts) == exact_bytes(made)


@pytest.mark.parametrize(
    ("kind", "make", "counts"),
    [(PointStamped, point_message, [3]), (Vector3Stamped, vector_message, [3]),
     (PoseStamped, pose_message, [3, 4]),
     (FluidPressure, lambda numbers, header: pressure_message(*numbers, header), [1])],
)  # fmt: skip
def test_messages_of_few_numbers_have_the_bytes_of_messages_made_anew(kind, make, counts):
    rng, of_bytes = np.random.default_rng(len(counts)), MessageBytes(make, "of_the_robot", *counts)
    for stamp in (0, 1_700_000_000_987_654_321):
        numbers = [rng.standard_normal(count) for count in counts]
        header = Header(stamp=stamp_of(stamp), frame_id="of_the_robot")
        assert of_bytes.message(stamp, *numbers) == exact_bytes(make(*numbers, header))
        assert deserialize_message(of_bytes.message(stamp, *numbers), kind) == make(*numbers, header)


def drawn(kind, rng):
    """A value of a kind as messages state them."""
    if kind.startswith("sequence<"):
        return [drawn(kind[len("sequence<") : -1], rng) for _ in range(rng.integers(4))]
    if kind == "string":
        return "aé" * rng.integers(4)
    if "/" not in kind:
        return {"double": float, "boolean": bool}.get(kind, int)(rng.integers(100))
    made = class_named(kind)()
    for field, inner in made.get_fields_and_field_types().items():
        setattr(made, field, drawn(inner, rng))
    return made


@pytest.mark.parametrize("kind", READERS)
def test_received_bytes_are_read_as_rclpy_reads_them(kind, drawn_rng):
    for _ in range(20):
        content = serialize_message(drawn(type_name(kind), drawn_rng))
        found, size = read_message(content + b"more", kind)
        by_both = (repr(found), repr(deserialize_message(content, kind)))
        ours, theirs = (re.sub(r"\w+\.msg\.|array\('\w'(, )?|[][()]", "", one) for one in by_both)
        assert ours == theirs
        assert size == len(exact_bytes(deserialize_message(content, kind)))
        for end in range(size):
            with pytest.raises(ValueError):
                read_message(content[:end], kind)
