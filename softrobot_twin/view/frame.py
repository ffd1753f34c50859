"""Input of the mirror: a stage, which never changes, and one frame per tick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError


class ViewError(SoftRobotTwinError):
    """A view cannot be opened, or a frame does not fit its stage.

    Attributes:
        key: Name of the argument or field, such as ``port``.
        value: Its value.
        reason: What is wrong, in one sentence.
    """

    def __init__(self, key: str, value: object, reason: str):
        self.key = key
        self.value = value
        self.reason = reason
        super().__init__(f"view: {key} = {value!r}: {reason}")


@dataclass(frozen=True)
class Surface:
    """A triangle surface to show; its name becomes part of an entity path.

    Attributes:
        name: Its name.
        triangles: Indices into its points, shape (triangle_count, 3).
        points: Its points [m], shape (point_count, 3), for a surface that does not deform: in the
            body's coordinates for a rigid body, in the world for an obstacle.

    Raises:
        ViewError: The triangles are not triples of valid indices.
    """

    name: str
    triangles: np.ndarray
    points: np.ndarray | None = None

    def __post_init__(self) -> None:
        triangles = np.asarray(self.triangles)
        key = f"triangles of {self.name}"
        if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
            raise ViewError(key, f"{triangles.dtype} array of {triangles.shape}",
                            "must be integers of shape (triangle_count, 3)")
        if triangles.size and triangles.min() < 0:
            raise ViewError(key, int(triangles.min()), "an index is negative")
        if self.points is not None:
            self.check_points(self.points)

    def check_points(self, points: np.ndarray) -> None:
        """Checks that the points include all corners of the triangles.

        Raises:
            ViewError: There are too few points, or the array is not of shape (n, 3).
        """
        shape, needed = np.shape(points), int(np.max(self.triangles, initial=-1)) + 1
        if len(shape) != 2 or shape[1] != 3 or shape[0] < needed:
            raise ViewError(f"positions of {self.name}", shape,
                            f"its triangles need at least ({needed}, 3)")


def _none(*shape: int) -> np.ndarray:
    """A field that is empty by default."""
    return field(default_factory=lambda: np.empty(shape))


class OtherActuator(NamedTuple):
    """An actuator that is drawn neither as a cable nor as a cavity, such as a slide.

    Attributes:
        name: Its name.
        setpoint_unit: Unit of its setpoint, such as ``m``; setpoints in metres are shown in mm.
        effort_unit: Unit of its effort, such as ``N``.
    """

    name: str
    setpoint_unit: str
    effort_unit: str


@dataclass(frozen=True)
class Stage:
    """The constant part of a view, checked when it is made.

    Attributes:
        name: Robot name.
        bodies: Deformable bodies, in the order of ``Frame.surface_positions``.
        cable_names: Cable names, in the order of ``Frame.cable_paths``.
        tension_range: Tensions of the two ends of the colour scale: slack and limit [N].
        effector_names: Effector names, in the order of ``Frame.effector_positions``.
        marker_ids: Marker identities, in the order of ``Frame.predicted_markers``.
        rigid_bodies: Rigid bodies, in the order of ``Frame.rigid_positions``.
        obstacles: Fixed obstacles.
        cavities: Walls of cavities, in the order of ``Frame.cavity_positions``.
        pressure_range: Gauge pressures of the two ends of the colour scale [Pa]: the deepest vacuum
            (0 without one) and the limit.
        other_actuators: Actuators that are drawn neither as cables nor as cavities, in the order of
            ``Frame.other_setpoints``.
        shows_contact: Whether frames may contain contacts.
        force_scale: Length of the arrow of a contact force [m/N].
        axis_length: Length of the axes of effectors with orientation [m]; 0 draws none.
        fixed_points: Places where bodies are fixed [m], shape (fixed_count, 3).

    Raises:
        ViewError: The range of tensions or pressures is empty, the force scale is not positive, a rigid surface has
            no points, or two objects of one kind have the same name.
    """

    name: str
    bodies: tuple[Surface, ...]
    cable_names: tuple[str, ...]
    tension_range: tuple[float, float]
    effector_names: tuple[str, ...]
    marker_ids: np.ndarray
    rigid_bodies: tuple[Surface, ...] = ()
    obstacles: tuple[Surface, ...] = ()
    cavities: tuple[Surface, ...] = ()
    pressure_range: tuple[float, float] = (0.0, 1.0)
    other_actuators: tuple[OtherActuator, ...] = ()
    shows_contact: bool = False
    force_scale: float = 0.1
    axis_length: float = 0.0
    fixed_points: np.ndarray = _none(0, 3)

    def __post_init__(self) -> None:
        for solid in (*self.rigid_bodies, *self.obstacles):
            if solid.points is None:
                raise ViewError("points", solid.name, "a rigid surface needs its points")
        if not (np.isfinite(self.force_scale) and self.force_scale > 0.0):
            raise ViewError("force_scale", self.force_scale, "must be above zero, in m/N")
        slack, limit = self.tension_range
        if not (np.isfinite(slack) and np.isfinite(limit) and slack < limit):
            raise ViewError("tension_range", self.tension_range,
                            "the second tension must be above the first, in newtons")
        vacuum, limit = self.pressure_range
        if not (np.isfinite(vacuum) and np.isfinite(limit) and vacuum <= 0.0 <= limit
                and vacuum < limit):
            raise ViewError("pressure_range", self.pressure_range,
                            "must reach from a vacuum or 0 to a pressure or 0, in pascals")
        for key, names in (("cable_names", self.cable_names),
                           ("other_actuators", [other.name for other in self.other_actuators]),
                           ("effector_names", self.effector_names),
                           ("bodies", [body.name for body in self.bodies]),
                           ("cavities", [cavity.name for cavity in self.cavities]),
                           ("rigid_bodies", [body.name for body in self.rigid_bodies]),
                           ("obstacles", [obstacle.name for obstacle in self.obstacles])):
            if len(set(names)) != len(names):
                raise ViewError(key, names, "two names are the same")


@dataclass(frozen=True)
class Frame:
    """One tick to show. The frame keeps its arrays, so the caller must pass copies.

    Attributes:
        step: Count of steps since the start.
        time_ns: Time of the tick [ns].
        surface_positions: Surface points of each deformable body [m], each of shape
            (point_count, 3).
        cable_paths: A polyline for each cable [m], each of shape (point_count, 3).
        cable_lengths: Cable lengths [m], shape (cable_count,).
        cable_tensions: Cable tensions [N], shape (cable_count,).
        effector_positions: Effectors [m], shape (effector_count, 3).
        targets: Target positions [m], shape (effector_count, 3); NaN rows have no target.
        effector_orientations: Turns of the effectors from rest (x, y, z, w), shape
            (effector_count, 4), NaN rows have none; without rows if the stage draws no axes.
        target_orientations: Wanted turns, same shape.
        predicted_markers: Markers predicted by the twin [m], shape (marker_count, 3).
        measured_markers: Measured markers [m], shape (marker_count, 3); NaN rows are hidden.
        effector_error: Distance of the effectors from their targets [m]; NaN without a target.
        stage_times: Time of each stage of the step [s].
        compute_time: Time of the whole step [s].
        status: The step's status as text.
        residual: Norm of the unbalanced force [N].
        linearization_error: Estimated error of the effectors due to linearization [m].
        discretization_error: Estimated error of the effectors due to the mesh [m].
        rigid_positions: Origins of the rigid bodies [m], shape (rigid_count, 3).
        rigid_quaternions: Their rotations (x, y, z, w), shape (rigid_count, 4).
        cavity_positions: Points of each cavity's walls [m], each of shape (point_count, 3).
        cavity_pressures: Gauge pressures [Pa], shape (cavity_count,).
        cavity_volumes: Volumes [m³], shape (cavity_count,).
        other_setpoints: Setpoints of the other actuators, such as positions of slides [m], shape
            (other_count,).
        other_efforts: Their efforts, such as the forces that hold slides [N], same shape.
        contact_positions: Contact points [m], shape (contact_count, 3).
        contact_forces: Force on the first body of each contact [N], same shape.
    """

    step: int
    time_ns: int
    surface_positions: tuple[np.ndarray, ...]
    cable_paths: tuple[np.ndarray, ...]
    cable_lengths: np.ndarray
    cable_tensions: np.ndarray
    effector_positions: np.ndarray
    targets: np.ndarray
    predicted_markers: np.ndarray
    measured_markers: np.ndarray
    effector_error: float
    stage_times: Mapping[str, float]
    compute_time: float
    status: str
    residual: float
    linearization_error: float = float("nan")
    discretization_error: float = float("nan")
    rigid_positions: np.ndarray = _none(0, 3)
    rigid_quaternions: np.ndarray = _none(0, 4)
    cavity_positions: tuple[np.ndarray, ...] = ()
    cavity_pressures: np.ndarray = _none(0)
    cavity_volumes: np.ndarray = _none(0)
    other_setpoints: np.ndarray = _none(0)
    other_efforts: np.ndarray = _none(0)
    effector_orientations: np.ndarray = _none(0, 4)
    target_orientations: np.ndarray = _none(0, 4)
    contact_positions: np.ndarray = _none(0, 3)
    contact_forces: np.ndarray = _none(0, 3)

    def check_against(self, stage: Stage) -> None:
        """Checks that the shapes of all arrays agree with the stage.

        Raises:
            ViewError: An array does not have the shape that the stage requires.
        """
        cables, cavities = len(stage.cable_names), len(stage.cavities)
        effectors, markers = len(stage.effector_names), len(stage.marker_ids)
        others, rigid = len(stage.other_actuators), len(stage.rigid_bodies)
        turned = effectors if stage.axis_length else 0
        contacts = len(self.contact_positions) if stage.shows_contact else 0
        expected = {
            "cable_paths": cables, "cable_lengths": (cables,), "cable_tensions": (cables,),
            "cavity_positions": cavities, "cavity_pressures": (cavities,),
            "cavity_volumes": (cavities,), "other_setpoints": (others,), "other_efforts": (others,),
            "effector_positions": (effectors, 3), "targets": (effectors, 3),
            "effector_orientations": (turned, 4), "target_orientations": (turned, 4),
            "predicted_markers": (markers, 3), "measured_markers": (markers, 3),
            "surface_positions": len(stage.bodies), "rigid_positions": (rigid, 3),
            "rigid_quaternions": (rigid, 4), "contact_positions": (contacts, 3),
            "contact_forces": (contacts, 3),
        }  # fmt: skip
        for key, wanted in expected.items():
            value = getattr(self, key)
            found = len(value) if isinstance(wanted, int) else np.shape(value)
            if found != wanted:
                raise ViewError(key, found, f"the stage requires {wanted}")
        for body, positions in zip(stage.bodies, self.surface_positions):
            body.check_points(positions)
        for cavity, positions in zip(stage.cavities, self.cavity_positions):
            cavity.check_points(positions)
