"""Effectors and markers of a scene."""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.effector import AXES, EffectorPoints, Effectors
from softrobot_twin.constraints.effector_orientation import (
    PatchOrientation,
    PosedEffectors,
    frame_arms,
    patch_arms,
    spans_a_plane,
)
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.simulation.building.scene_layout import Layout

def effector_term(layout: Layout, notes: list[str]):
    """The constraint term of the effectors of a scene.

    Args:
        layout: The bodies.
        notes: List to which warnings are appended.

    Raises:
        SceneError: A point does not lie on its body, or the points of an orientation lie on a line.
    """
    effectors, orientations = [], []
    for index, (key, effector) in enumerate(layout.scene.keyed("effectors")):
        points = layout.carried(
            effector.body, effector.points, f"{key}.points", notes,
            remedy="; several points count by their mean: for a place in a hollow part, give points "
            "on the material around it",
        )  # fmt: skip
        carriers = points.nodes[points.barycentric_weights != 0.0]
        if not layout.scene.slides and (layout.nodes.free_index[carriers] < 0).all():
            notes.append(f"{key} ({effector.name}) lies wholly in what is fixed or guided: "
                         "no actuator moves it.")  # fmt: skip
        directions = tuple(AXES[direction] for direction in effector.directions)
        effectors.append(EffectorPoints(effector.name, points, directions, effector.weight))
        if effector.orientation:
            orientations.append(_orientation(layout, index, points, notes))
    free_index = layout.nodes.free_index
    if orientations:
        return PosedEffectors(tuple(effectors), tuple(orientations), free_index)
    return Effectors(tuple(effectors), free_index)


def _orientation(
    layout: Layout, index: int, points: BarycentricMapping, notes: list[str]
) -> PatchOrientation:
    """The orientation of one effector, on the frame or the patch that carries its points."""
    effector = layout.scene.effectors[index]
    entry, rest = effector.orientation, layout.nodes.rest_positions
    key = f"effectors[{index}].points"
    if entry.points:
        key = f"effectors[{index}].orientation.points"
        points = layout.carried(effector.body, entry.points, key, notes)
    frame = frame_of(layout, points)
    if frame is not None:
        nodes, arms = frame_arms(frame, rest)
    else:
        if not spans_a_plane(points.positions(rest)):
            raise layout.scene.error(
                key, [list(point) for point in entry.points or effector.points],
                f"{effector.name} asks for an orientation: on a deformable body three or more "
                "points that do not lie on one line are needed", unit="m")
        nodes, arms = patch_arms(points, rest)
    axis = np.array(entry.pointing, float) / np.linalg.norm(entry.pointing) if entry.pointing else None
    length = entry.length_per_radian or layout.nodes.size
    return PatchOrientation(index, nodes, arms, frame is not None, axis, entry.weight, length)


def frame_of(layout: Layout, points: BarycentricMapping) -> int | None:
    """First node of the one frame that carries all points; None where there is none.

    Args:
        layout: The bodies.
        points: The points.
    """
    if not layout.framed:
        return None
    carriers = points.nodes[points.barycentric_weights != 0.0] - layout.frames.first_node
    bodies = np.unique(carriers // 4)
    if len(bodies) != 1 or not 0 <= bodies[0] < layout.frames.body_count:
        return None
    return int(layout.frames.first_node + 4 * bodies[0])


def marker_mapping(layout: Layout, notes: list[str]):
    """The markers of a scene.

    Args:
        layout: The scene with its bodies placed.
        notes: List to which warnings are appended.

    Returns:
        Their mapping, their ids, and for each effector the indices of the markers that measure it.
    """
    scene = layout.scene
    markers = BarycentricMapping(np.empty((0, 4), np.int64), np.empty((0, 4)))
    order: list[int] = []
    names = dict.fromkeys(marker.body for marker in scene.markers)
    for name in names:
        own = [index for index, marker in enumerate(scene.markers) if marker.body == name]
        points = [scene.markers[index].point for index in own]
        key = "markers" if len(names) == 1 else f"markers on {name}"
        markers = markers.followed_by(layout.carried(name, points, key, notes))
        order += own
    place = np.argsort(np.array(order, np.int64))
    markers = BarycentricMapping(markers.nodes[place], markers.barycentric_weights[place])
    ids = [marker.id for marker in scene.markers]
    moving_with = tuple(
        np.array([ids.index(marker) for marker in effector.measured_by], np.int64)
        for effector in scene.effectors
    )
    return markers, np.array(ids, np.uint32), moving_with
