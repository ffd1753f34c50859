"""What the mirror is given: a stage that never changes, and one frame a tick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from softrobot_twin.view.refusal import ViewError


@dataclass(frozen=True)
class Stage:
    """What a run shows that never changes, checked when it is made.

    Attributes:
        name: Robot name.
        surface_triangles: Indices into ``Frame.surface_positions``, shape (triangle_count, 3).
        cable_names: Cable names, in the order of ``Frame.cable_paths``.
        tension_range: Tensions of the two ends of the colour scale: slack and limit [N].
        effector_names: Effector names, in the order of ``Frame.effector_positions``.
        marker_ids: Marker identities, in the order of ``Frame.predicted_markers``.

    Raises:
        ViewError: The triangles are not triples of indices, the tension range does not rise,
            or two cables (or two effectors) share a name.
    """

    name: str
    surface_triangles: np.ndarray
    cable_names: tuple[str, ...]
    tension_range: tuple[float, float]
    effector_names: tuple[str, ...]
    marker_ids: np.ndarray

    def __post_init__(self) -> None:
        triangles = np.asarray(self.surface_triangles)
        if triangles.ndim != 2 or triangles.shape[1] != 3 or triangles.dtype.kind not in "iu":
            raise ViewError("surface_triangles", f"{triangles.dtype} array of {triangles.shape}",
                            "must be integers of shape (triangle_count, 3)")
        if triangles.size and triangles.min() < 0:
            raise ViewError("surface_triangles", int(triangles.min()), "an index is negative")
        slack, limit = self.tension_range
        if not (np.isfinite(slack) and np.isfinite(limit) and slack < limit):
            raise ViewError("tension_range", self.tension_range, "must rise, in newtons")
        for key, names in (("cable_names", self.cable_names),
                           ("effector_names", self.effector_names)):
            if len(set(names)) != len(names):
                raise ViewError(key, names, "two of them are the same")


@dataclass(frozen=True)
class Frame:
    """One tick as it is shown. Its arrays belong to it: whoever makes a frame copies.

    Attributes:
        step: Count of steps since the start.
        time_ns: Time of the tick [ns].
        surface_positions: Surface nodes [m], shape (surface_node_count, 3).
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
    """

    step: int
    time_ns: int
    surface_positions: np.ndarray
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

    def refuse_if_unlike(self, stage: Stage) -> None:
        """Compare shapes with the stage, so that no curve carries another's name.

        Raises:
            ViewError: An array does not have the shape that the stage calls for.
        """
        cable_count = len(stage.cable_names)
        effector_shape = (len(stage.effector_names), 3)
        marker_shape = (len(stage.marker_ids), 3)
        expected = {
            "cable_paths": (len(self.cable_paths), cable_count),
            "cable_lengths": (np.shape(self.cable_lengths), (cable_count,)),
            "cable_tensions": (np.shape(self.cable_tensions), (cable_count,)),
            "effector_positions": (np.shape(self.effector_positions), effector_shape),
            "targets": (np.shape(self.targets), effector_shape),
            "predicted_markers": (np.shape(self.predicted_markers), marker_shape),
            "measured_markers": (np.shape(self.measured_markers), marker_shape),
        }
        for key, (found, wanted) in expected.items():
            if found != wanted:
                raise ViewError(key, found, f"the stage calls for {wanted}")
        nodes = np.shape(self.surface_positions)
        needed = int(np.max(stage.surface_triangles, initial=-1)) + 1
        if len(nodes) != 2 or nodes[1] != 3 or nodes[0] < needed:
            raise ViewError("surface_positions", nodes,
                            f"the stage's triangles need at least ({needed}, 3)")
