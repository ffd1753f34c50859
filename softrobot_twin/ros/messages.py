"""Conversion between arrays and ROS messages.

rclpy does not check the types of message fields, so numbers are converted to float here.
"""

from __future__ import annotations

import array
from collections.abc import Callable, Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import (
    Point,
    PointStamped,
    Pose,
    PoseStamped,
    Quaternion,
    Twist,
    Vector3,
    Vector3Stamped,
    Wrench,
    WrenchStamped,
)
from nav_msgs.msg import Path
from sensor_msgs.msg import FluidPressure, JointState, PointCloud2, PointField
from std_msgs.msg import Float64MultiArray, Header, MultiArrayDimension, MultiArrayLayout

from softrobot_twin.control.arrival import Arrival, Refusal
from softrobot_twin.control.loop_timing import NANOSECONDS

_CONTACT = np.dtype([(name, "<f4") for name in ("x", "y", "z", "fx", "fy", "fz")])
_MARKER = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("id", "<u4")])
# PointField numbers its types in this order, from INT8 on.
_DATATYPES = dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"), PointField.INT8))
MAX_MARKERS = 10_000
"""Most points of a marker message. A larger message is refused: it cannot come from markers, and
reading it would take longer than a tick.
"""
_MAX_FIELDS = 100
_MARKER_FIELDS = {"x": ("f4", "f8"), "y": ("f4", "f8"), "z": ("f4", "f8"), "id": ("u4",)}


def stamp_of(nanoseconds: int) -> Time:
    """A message's time from nanoseconds.

    Args:
        nanoseconds: The time [ns].
    """
    seconds, rest = divmod(int(nanoseconds), NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def arrival_of(header: Header, ros_time: int, time: float) -> Arrival:
    """A message's header with its time of arrival on both clocks [ns, s].

    Args:
        header: Header of the message.
        ros_time: Time of arrival on the clock of stamps [ns].
        time: Time of arrival on the monotonic clock [s].
    """
    return Arrival(header.frame_id, _nanoseconds(header), ros_time, time)


def coordinates(kind: type, numbers: np.ndarray):
    """A message of a kind that has the fields x, y, z, or x, y, z, w.

    Args:
        kind: Class of the message, such as `Point` or `Quaternion`.
        numbers: Its values, shape (3,) or (4,).
    """
    return kind(**dict(zip("xyzw", map(float, numbers))))


def point_message(position: np.ndarray, header: Header) -> PointStamped:
    """A position [m], shape (3,), as a message.

    Args:
        position: The position [m], shape (3,).
        header: Header of the message.
    """
    return PointStamped(header=header, point=coordinates(Point, position))


def vector_message(vector: np.ndarray, header: Header) -> Vector3Stamped:
    """A vector, shape (3,), as a message.

    Args:
        vector: The vector, shape (3,).
        header: Header of the message.
    """
    return Vector3Stamped(header=header, vector=coordinates(Vector3, vector))


def pose_message(position: np.ndarray, quaternion: np.ndarray, header: Header) -> PoseStamped:
    """A position [m], shape (3,), and a quaternion (x, y, z, w) as a message.

    Args:
        position: The position [m], shape (3,).
        quaternion: The turn (x, y, z, w), shape (4,).
        header: Header of the message.
    """
    pose = Pose(position=coordinates(Point, position), orientation=coordinates(Quaternion, quaternion))
    return PoseStamped(header=header, pose=pose)


def read_pose(message: PoseStamped) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Position [m] and quaternion (x, y, z, w) of a message, as they are.

    Args:
        message: The message.
    """
    p, q = message.pose.position, message.pose.orientation
    return (p.x, p.y, p.z), (q.x, q.y, q.z, q.w)


def path_message(times: np.ndarray, positions: np.ndarray, header: Header) -> Path:
    """Positions [m], shape (n, 3), at times after the stamp of a header [s] as a message.

    Args:
        times: The times [s], shape (n,).
        positions: The positions [m], shape (n, 3).
        header: Header of the message.
    """
    begin, turn = _nanoseconds(header), np.array([0.0, 0.0, 0.0, 1.0])
    return Path(header=header, poses=[
        pose_message(position, turn, Header(
            stamp=stamp_of(begin + round(time * NANOSECONDS)), frame_id=header.frame_id))
        for time, position in zip(times, positions, strict=True)])  # fmt: skip


def read_path(message: Path) -> tuple[list[float], list[tuple[float, ...]]]:
    """Times after the stamp of a message [s], and the positions there [m]; turns are not read.

    Args:
        message: The message; each pose has a stamp.
    """
    begin = _nanoseconds(message.header)
    times = [(_nanoseconds(pose.header) - begin) / NANOSECONDS for pose in message.poses]
    return times, [_xyz_of(pose.pose.position) for pose in message.poses]


def _nanoseconds(header: Header) -> int:
    return header.stamp.sec * NANOSECONDS + header.stamp.nanosec


def _xyz_of(point: Point | Vector3) -> tuple[float, float, float]:
    return point.x, point.y, point.z


def _twist_of(message: Twist) -> tuple[float, ...]:
    """Its velocity, and behind it its angular velocity if there is any."""
    turn_rate = _xyz_of(message.angular)
    return _xyz_of(message.linear) + (turn_rate if any(turn_rate) else ())


def cables_message(
    names: Sequence[str], lengths: np.ndarray, tensions: np.ndarray, header: Header
) -> JointState:
    """Setpoints and efforts of actuators, such as lengths [m] and tensions [N], as a message.

    Angles [rad] and torques [N m] of pulleys too; and of a touch the displacement [m] and force [N]
    along x, y and z.

    Args:
        names: Names of the actuators.
        lengths: Setpoints in the unit of each actuator's kind, pressures gauge [Pa], shape
            (actuator_count,).
        tensions: Efforts in the unit of each actuator's kind, same shape; empty for none.
        header: Frame and time.
    """
    return JointState(
        header=header,
        name=list(names),
        position=np.asarray(lengths, dtype=float).tolist(),
        effort=np.asarray(tensions, dtype=float).tolist(),
    )


def wrench_message(force: np.ndarray, header: Header, torque: np.ndarray = np.zeros(3)) -> WrenchStamped:
    """A force [N] and a torque [N m], shape (3,) each, as a message.

    Args:
        force: The force [N], shape (3,).
        header: Header of the message.
        torque: The torque [N m], shape (3,); none by default.
    """
    wrench = Wrench(force=coordinates(Vector3, force), torque=coordinates(Vector3, torque))
    return WrenchStamped(header=header, wrench=wrench)


def pressure_message(pressure: float, header: Header, variance: float = 0.0) -> FluidPressure:
    """An absolute pressure [Pa] as a message; a variance [Pa²] of 0 is unknown.

    Args:
        pressure: The absolute pressure [Pa].
        header: Header of the message.
        variance: Its variance [Pa²]; 0 for unknown.
    """
    return FluidPressure(header=header, fluid_pressure=float(pressure), variance=float(variance))


def markers_message(ids: np.ndarray, positions: np.ndarray, header: Header) -> PointCloud2:
    """Markers as a message.

    Args:
        ids: Marker ids, shape (marker_count,).
        positions: Their positions [m], shape (marker_count, 3); NaN where hidden.
        header: Frame and time.
    """
    points = np.empty(len(ids), dtype=_MARKER)
    points["x"], points["y"], points["z"] = positions.T
    points["id"] = ids
    return _cloud(points, header, is_dense=bool(np.isfinite(positions).all()))


def contacts_message(positions: np.ndarray, forces: np.ndarray, header: Header) -> PointCloud2:
    """Contacts as a message with the fields x y z [m] and fx fy fz [N].

    Args:
        positions: Contact points [m], shape (contact_count, 3).
        forces: Force on the first body of each contact [N], same shape.
        header: Frame and time.
    """
    points = np.hstack([positions, forces]).astype("<f4").view(_CONTACT)[:, 0]
    return _cloud(points, header, is_dense=True)


def matrix_message(
    matrix: np.ndarray, rows: Sequence[str], columns: Sequence[str], header: Header
) -> Float64MultiArray:
    """A matrix as a message. Its layout names rows and columns, separated by spaces.

    A Float64MultiArray has no header: the stamp is in the two numbers before the matrix, seconds
    and nanoseconds, which `layout.data_offset` tells to skip.

    Args:
        matrix: Shape (row_count, column_count).
        rows: Name and unit of each row, such as ``x_m``.
        columns: Name and unit of each column, such as ``north_shortening_m``.
        header: Frame and time.
    """
    stamp = [float(header.stamp.sec), float(header.stamp.nanosec)]
    row_count, column_count = matrix.shape
    dimensions = [
        MultiArrayDimension(label=" ".join(rows), size=row_count, stride=matrix.size),
        MultiArrayDimension(label=" ".join(columns), size=column_count, stride=column_count),
    ]
    return Float64MultiArray(
        layout=MultiArrayLayout(dim=dimensions, data_offset=len(stamp)),
        data=stamp + np.asarray(matrix, dtype=float).ravel().tolist(),
    )


def _cloud(points: np.ndarray, header: Header, is_dense: bool) -> PointCloud2:
    """A structured array of points as a message; each column becomes a field."""
    fields = [
        PointField(name=name, offset=offset, count=1,
                   datatype=PointField.UINT32 if kind == np.uint32 else PointField.FLOAT32)
        for name, (kind, offset) in points.dtype.fields.items()
    ]  # fmt: skip
    size = points.dtype.itemsize
    return PointCloud2(
        header=header, height=1, width=len(points), fields=fields, is_bigendian=False,
        point_step=size, row_step=size * len(points), data=array.array("B", points.tobytes()),
        is_dense=is_dense,
    )  # fmt: skip


def read_markers(message: PointCloud2) -> tuple[np.ndarray, np.ndarray] | Refusal:
    """Reads ids, uint32 (n,), and positions [m], (n, 3), or returns the reason of refusal.

    Any layout with scalar fields x, y, z and id is accepted, in both byte orders, with or without
    padding.

    Args:
        message: The message.
    """
    found = _marker_fields(message)
    if found is None:
        return Refusal.WRONG_FIELDS
    width, height, step = message.width, message.height, message.point_step
    # Compare sizes as Python integers first: a message may state any size, and numpy's integers can
    # overflow.
    ends = [offset + np.dtype(kind).itemsize for kind, offset in found.values()]
    if max(ends) > step or message.row_step < width * step:
        return Refusal.WRONG_SIZE
    if len(message.data) != message.row_step * height or width * height > MAX_MARKERS:
        return Refusal.WRONG_SIZE
    if width * height == 0:
        return np.empty(0, np.uint32), np.empty((0, 3))
    # From here on every point lies inside the data.
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(height, message.row_step)
    points = np.ascontiguousarray(rows[:, : width * step]).reshape(width * height, step)
    columns = {
        name: np.ascontiguousarray(points[:, offset : offset + np.dtype(kind).itemsize])
        .view(kind)[:, 0]
        for name, (kind, offset) in found.items()
    }
    # Converting a signalling NaN makes numpy warn; NaN is a valid value here.
    with np.errstate(invalid="ignore"):
        positions = np.column_stack([columns[name].astype(float) for name in "xyz"])
    return columns["id"].astype(np.uint32), positions


def _marker_fields(message: PointCloud2) -> dict[str, tuple[str, int]] | None:
    """Type and offset of the fields x, y, z and id; None when one is missing or has a wrong
    type.
    """
    if len(message.fields) > _MAX_FIELDS:
        return None
    order = ">" if message.is_bigendian else "<"
    found: dict[str, tuple[str, int]] = {}
    for field in message.fields:
        kind = _DATATYPES.get(field.datatype)
        if field.name in _MARKER_FIELDS and field.count in (0, 1):
            if kind not in _MARKER_FIELDS[field.name] or field.name in found:
                return None
            found[field.name] = (order + kind, field.offset)
    return found if found.keys() == _MARKER_FIELDS.keys() else None


READERS: dict[type, Callable[..., tuple | Refusal]] = {
    PointStamped: lambda message: (_xyz_of(message.point),),
    PoseStamped: read_pose,
    Path: read_path,
    Vector3Stamped: lambda message: (_xyz_of(message.vector),),
    WrenchStamped: lambda message: (_xyz_of(message.wrench.force),),
    Twist: lambda message: (_twist_of(message),),
    FluidPressure: lambda message: (message.fluid_pressure,),
    JointState: lambda message: (message.name, message.position, message.effort),
    PointCloud2: read_markers,
}
"""What gives the values of a received message of each type as they are, or the reason to refuse it:
positions [m], quaternions (x, y, z, w), absolute pressures [Pa], names, positions and efforts."""
