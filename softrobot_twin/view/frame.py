"""The input of the mirror: a stage that never changes, and one frame a tick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from softrobot_twin.errors import SoftRobotTwinError


class ViewError(SoftRobotTwinError):
    """A view cannot be opened, or a frame cannot be shown.

    Attributes:
        key: What was asked for or given, such as ``port``.
        value: Its value.
        reason: Why it cannot be, in one sentence.
    """

    def __init__(self, key: str, value: object, reason: str):
        self.key = key
        self.value = value
        self.reason = reason
        super().__init__(f"view: {key} = {value!r}: {reason}")


@dataclass(frozen=True)
class Surface:
    """The triangles of something that is shown; its name becomes part of an entity path.

    Attributes:
        name: Its name.
        triangles: Indices into its points, shape (triangle_count, 3).
        points: Its points [m], shape (point_count, 3), where they do not deform: those of a rigid
            body in its own coordinates, those of an obstacle in the world.

    Raises:
        ViewError: The triangles are not triples of indices, or name points that there are not.
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
            self.refuse_points_unlike(self.points)

    def refuse_points_unlike(self, points: np.ndarray) -> None:
        """Check that the triangles find all their points.

        Raises:
            ViewError: There are too few, or they are not points.
        """
        shape, needed = np.shape(points), int(np.max(self.triangles, initial=-1)) + 1
        if len(shape) != 2 or shape[1] != 3 or shape[0] < needed:
            raise ViewError(f"positions of {self.name}", shape,
                            f"its triangles need at least ({needed}, 3)")


def _none() -> np.ndarray:
    return np.empty((0, 3))


class OtherActuator(NamedTuple):
    """An actuator that is not drawn as a cable: a slide, a cavity.

    Attributes:
        name: Its name.
        setpoint_unit: Unit of its setpoint, such as ``m``; what is in metres is shown in mm.
        effort_unit: Unit of its effort, such as ``N``.
    """

    name: str
    setpoint_unit: str
    effort_unit: str


@dataclass(frozen=True)
class Stage:
    """What a run shows that never changes, checked when it is made.

    Attributes:
        name: Robot name.
        bodies: Deformable bodies, in the order of ``Frame.surface_positions``.
        cable_names: Cable names, in the order of ``Frame.cable_paths``.
        tension_range: Tensions of the two ends of the colour scale: slack and limit [N].
        effector_names: Effector names, in the order of ``Frame.effector_positions``.
        marker_ids: Marker identities, in the order of ``Frame.predicted_markers``.
        rigid_bodies: Rigid bodies, in the order of ``Frame.rigid_positions``.
        obstacles: What stands still.
        other_actuators: Actuators that are not drawn as cables, in the order of
            ``Frame.other_setpoints``.
        shows_contact: Whether frames may tell contacts.
        force_scale: Length of the arrow of a contact force [m/N].

    Raises:
        ViewError: The tension range does not rise, the force scale is not above zero, a solid has
            no points, or two things of a kind share a name.
    """

    name: str
    bodies: tuple[Surface, ...]
    cable_names: tuple[str, ...]
    tension_range: tuple[float, float]
    effector_names: tuple[str, ...]
    marker_ids: np.ndarray
    rigid_bodies: tuple[Surface, ...] = ()
    obstacles: tuple[Surface, ...] = ()
    other_actuators: tuple[OtherActuator, ...] = ()
    shows_contact: bool = False
    force_scale: float = 0.1

    def __post_init__(self) -> None:
        for solid in (*self.rigid_bodies, *self.obstacles):
            if solid.points is None:
                raise ViewError("points", solid.name, "a solid's surface needs its points")
        if not (np.isfinite(self.force_scale) and self.force_scale > 0.0):
            raise ViewError("force_scale", self.force_scale, "must be above zero, in m/N")
        slack, limit = self.tension_range
        if not (np.isfinite(slack) and np.isfinite(limit) and slack < limit):
            raise ViewError("tension_range", self.tension_range, "must rise, in newtons")
        for key, names in (("cable_names", self.cable_names),
                           ("other_actuators", [other.name for other in self.other_actuators]),
                           ("effector_names", self.effector_names),
                           ("bodies", [body.name for body in self.bodies]),
                           ("rigid_bodies", [body.name for body in self.rigid_bodies]),
                           ("obstacles", [obstacle.name for obstacle in self.obstacles])):
            if len(set(names)) != len(names):
                raise ViewError(key, names, "two of them are the same")


@dataclass(frozen=True)
class Frame:
    """One tick as it is shown. Its arrays belong to it: whoever makes a frame copies.

    Attributes:
        step: Count of steps since the start.
        time_ns: Time of the tick [ns].
        surface_positions: Surface points of each deformable body [m], each of shape
            (point_count, 3).
        cable_paths: A polyline for each cable [m], each of shape (point_count, 3).
        cable_lengths: Cable lengths [m], shape (cable_count,).
        cable_tensions: Cable tensions [N], shape (cable_count,).
        effector_positions: Effectors [m], shape (effector_count, 3).
        targets: Where they should be [m], shape (effector_count, 3); NaN rows have no target.
        predicted_markers: Markers as the twin believes [m], shape (marker_count, 3).
        measured_markers: Markers as seen [m], shape (marker_count, 3); NaN rows are hidden.
        effector_error: Distance that is left to the targets [m]; NaN without a target.
        stage_times: Time that each stage of the step took [s].
        compute_time: Time that the whole step took [s].
        status: The step's status in a word or two.
        residual: Norm of the force that is out of balance [N].
        linearization_error: What one linearization left of the effectors' way, estimated [m].
        discretization_error: How far the mesh puts the effectors off, estimated [m].
        rigid_positions: Where the rigid bodies' coordinates stand [m], shape (rigid_count, 3).
        rigid_quaternions: How they are turned (x, y, z, w), shape (rigid_count, 4).
        other_setpoints: Setpoints of the other actuators, such as positions of slides [m], shape
            (other_count,).
        other_efforts: Their efforts, such as the forces that hold slides [N], same shape.
        contact_positions: Where bodies touch [m], shape (contact_count, 3).
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
    rigid_positions: np.ndarray = field(default_factory=_none)
    rigid_quaternions: np.ndarray = field(default_factory=lambda: np.empty((0, 4)))
    other_setpoints: np.ndarray = field(default_factory=lambda: np.empty(0))
    other_efforts: np.ndarray = field(default_factory=lambda: np.empty(0))
    contact_positions: np.ndarray = field(default_factory=_none)
    contact_forces: np.ndarray = field(default_factory=_none)

    def refuse_if_unlike(self, stage: Stage) -> None:
        """Compare shapes with the stage, so that no curve carries another's name.

        Raises:
            ViewError: An array does not have the shape that the stage calls for.
        """
        cable_count = len(stage.cable_names)
        effector_shape = (len(stage.effector_names), 3)
        marker_shape = (len(stage.marker_ids), 3)
        rigid_count = len(stage.rigid_bodies)
        contact_shape = (len(self.contact_positions) if stage.shows_contact else 0, 3)
        expected = {
            "cable_paths": (len(self.cable_paths), cable_count),
            "cable_lengths": (np.shape(self.cable_lengths), (cable_count,)),
            "cable_tensions": (np.shape(self.cable_tensions), (cable_count,)),
            "other_setpoints": (np.shape(self.other_setpoints), (len(stage.other_actuators),)),
            "other_efforts": (np.shape(self.other_efforts), (len(stage.other_actuators),)),
            "effector_positions": (np.shape(self.effector_positions), effector_shape),
            "targets": (np.shape(self.targets), effector_shape),
            "predicted_markers": (np.shape(self.predicted_markers), marker_shape),
            "measured_markers": (np.shape(self.measured_markers), marker_shape),
            "surface_positions": (len(self.surface_positions), len(stage.bodies)),
            "rigid_positions": (np.shape(self.rigid_positions), (rigid_count, 3)),
            "rigid_quaternions": (np.shape(self.rigid_quaternions), (rigid_count, 4)),
            "contact_positions": (np.shape(self.contact_positions), contact_shape),
            "contact_forces": (np.shape(self.contact_forces), contact_shape),
        }
        for key, (found, wanted) in expected.items():
            if found != wanted:
                raise ViewError(key, found, f"the stage calls for {wanted}")
        for body, positions in zip(stage.bodies, self.surface_positions):
            body.refuse_points_unlike(positions)
