"""Conversion between arrays and messages."""

import array

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from softrobot_twin.control.arrival import Refusal
from softrobot_twin.ros.messages import (
    arrival_of,
    cables_message,
    markers_message,
    point_message,
    read_markers,
    stamp_of,
)

pytestmark = pytest.mark.libraries

IDS = np.array([4, 2**32 - 1, 0], dtype=np.uint32)
PLACES = np.array([[0.1, -0.2, 0.3], [np.nan] * 3, [1.0, 2.0, 3.0]])
HEADER = Header(frame_id="base_link")


def test_markers_are_unchanged_by_conversion_to_a_message_and_back():
    ids, places = read_markers(markers_message(IDS, PLACES, HEADER))
    assert ids.tolist() == IDS.tolist()
    np.testing.assert_allclose(places, PLACES, rtol=1e-7)


def cloud(dtype, values, bigendian=False, rows=1, row_padding=0):
    """A message of any layout."""
    datatypes = {"f4": 7, "f8": 8, "u4": 6, "i4": 5, "u1": 2, "f2": 99}
    points = np.zeros(len(values), dtype=dtype)
    for name in points.dtype.names:
        points[name] = [value[name] for value in values]
    width = len(values) // rows
    lines = points.reshape(rows, width)
    data = b"".join(line.tobytes() + bytes(row_padding) for line in lines)
    return PointCloud2(
        header=HEADER, height=rows, width=width, is_bigendian=bigendian,
        point_step=points.dtype.itemsize, row_step=points.dtype.itemsize * width + row_padding,
        fields=[
            PointField(name=name, offset=offset, datatype=datatypes[kind.str[1:]], count=1)
            for name, (kind, offset) in points.dtype.fields.items()
        ],
        data=array.array("B", data),
    )


VALUES = [{"x": 0.5 * i, "y": 1.0 * i, "z": 2.0 * i, "id": 7 + i, "intensity": 9.0}
          for i in range(4)]


@pytest.mark.parametrize("dtype, options", [
    ([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("id", "<u4")], {}),
    ([("id", "<u4"), ("z", "<f8"), ("y", "<f8"), ("x", "<f8")], {}),
    ([("x", ">f4"), ("y", ">f4"), ("z", ">f4"), ("id", ">u4")], {"bigendian": True}),
    ([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("id", "<u4")], {}),
    ({"names": ["x", "y", "z", "id"], "formats": ["<f4", "<f4", "<f4", "<u4"],
      "offsets": [0, 4, 8, 16], "itemsize": 32}, {}),
    ([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("id", "<u4")], {"rows": 2, "row_padding": 3}),
])  # fmt: skip
def test_any_layout_of_an_array_message_is_read(dtype, options):
    ids, places = read_markers(cloud(dtype, VALUES, **options))
    assert ids.tolist() == [7, 8, 9, 10] and ids.dtype == np.uint32
    assert places.tolist() == [[v["x"], v["y"], v["z"]] for v in VALUES]


def test_an_empty_list_of_markers_is_a_valid_message():
    ids, places = read_markers(markers_message(IDS[:0], PLACES[:0], HEADER))
    assert ids.shape == (0,) and places.shape == (0, 3)


def test_values_read_are_copies_of_the_message():
    message = markers_message(IDS, PLACES, HEADER)
    _, places = read_markers(message)
    message.data[:] = array.array("B", bytes(len(message.data)))
    assert places[0, 0] == pytest.approx(0.1)


def spoiled(**fields):
    message = markers_message(IDS, PLACES, HEADER)
    for name, value in fields.items():
        setattr(message, name, value)
    return message


def renamed(index, **fields):
    message = markers_message(IDS, PLACES, HEADER)
    for name, value in fields.items():
        setattr(message.fields[index], name, value)
    return message


@pytest.mark.parametrize("message, refusal", [
    (spoiled(data=array.array("B", bytes(47))), Refusal.WRONG_SIZE),
    (spoiled(data=array.array("B", bytes(64))), Refusal.WRONG_SIZE),
    (spoiled(width=4), Refusal.WRONG_SIZE),
    (spoiled(width=2**32 - 1), Refusal.WRONG_SIZE),
    (spoiled(height=2), Refusal.WRONG_SIZE),
    (spoiled(point_step=12), Refusal.WRONG_SIZE),
    (spoiled(point_step=0), Refusal.WRONG_SIZE),
    (spoiled(row_step=0), Refusal.WRONG_SIZE),
    (spoiled(fields=[]), Refusal.WRONG_FIELDS),
    (renamed(0, name="a"), Refusal.WRONG_FIELDS),
    (renamed(0, datatype=PointField.INT32), Refusal.WRONG_FIELDS),
    (renamed(3, datatype=PointField.FLOAT32), Refusal.WRONG_FIELDS),
    (renamed(0, count=3), Refusal.WRONG_FIELDS),
    (renamed(1, name="x"), Refusal.WRONG_FIELDS),
    (renamed(3, offset=2**32 - 1), Refusal.WRONG_SIZE),
])  # fmt: skip
def test_an_inconsistent_layout_is_refused(message, refusal):
    assert read_markers(message) is refusal


def test_numbers_of_numpy_become_floats():
    point = point_message(np.array([1, 2, 3], dtype=np.float32), HEADER).point
    assert [type(value) for value in (point.x, point.y, point.z)] == [float] * 3
    cables = cables_message(("a", "b"), np.array([1, 2]), np.float32([3.0, 4.0]), HEADER)
    assert cables.name == ["a", "b"]
    assert list(cables.position) == [1.0, 2.0] and list(cables.effort) == [3.0, 4.0]


def test_a_stamp_is_unchanged_by_conversion_to_a_message_and_back():
    nanoseconds = 1_700_000_000_123_456_789
    arrival = arrival_of(Header(stamp=stamp_of(nanoseconds), frame_id="f"), 5, 6.0)
    assert arrival == ("f", nanoseconds, 5, 6.0)
