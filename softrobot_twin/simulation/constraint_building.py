"""Effectors of a scene, and its markers."""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.effector import AXES, EffectorPoints, Effectors
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.simulation.scene_layout import Layout


def effector_term(layout: Layout, notes: list[str]):
    """The constraint term of the effectors of a scene.

    Args:
        layout: The bodies.
        notes: List to which warnings are appended.

    Raises:
        SceneError: A point does not lie on its body.
    """
    effectors = []
    for index, effector in enumerate(layout.scene.effectors):
        key = f"effectors[{index}]"
        points = layout.carried(effector.body, effector.points, f"{key}.points", notes)
        carriers = points.nodes[points.barycentric_weights != 0.0]
        if not layout.scene.slides and (layout.nodes.free_index[carriers] < 0).all():
            notes.append(f"{key} ({effector.name}) lies wholly in what is fixed or guided: "
                         "no actuator moves it.")  # fmt: skip
        directions = tuple(AXES[direction] for direction in effector.directions)
        effectors.append(
            EffectorPoints(effector.name, points, directions, effector.weight)
        )
    return Effectors(tuple(effectors), layout.nodes.free_index, layout.nodes.size)


def marker_mapping(layout: Layout, notes: list[str]):
    """The markers of a scene.

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
