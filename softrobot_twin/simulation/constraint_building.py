"""Constraint terms of a scene: cables, effectors, and the markers that are only watched."""

from __future__ import annotations

import numpy as np

from softrobot_twin.constraints.cable import CablePath, Cables, folds
from softrobot_twin.constraints.effector import AXES, EffectorPoints, Effectors
from softrobot_twin.mechanics.barycentric import BarycentricMapping
from softrobot_twin.scene import Scene
from softrobot_twin.simulation.cable_warnings import check_cables_move
from softrobot_twin.simulation.scene_layout import Layout
from softrobot_twin.simulation.limits import ActuatorLimits


def cable_term(layout: Layout, notes: list[str]):
    """The cables of a scene.

    Args:
        layout: The bodies.
        notes: Takes what looks wrong.

    Returns:
        Their constraint term.

    Raises:
        SceneError: A point does not lie on its body, or a cable moves nothing.
    """
    paths = []
    for index, cable in enumerate(layout.scene.cables):
        key = f"cables[{index}]"
        path = _cable_path(layout, cable, key, notes)
        for fold in folds(path.positions(layout.nodes.rest_positions)):
            where = "pull_point" if fold == 0 else f"points[{fold - 1}]"
            notes.append(
                f"{key} ({cable.name}) folds back on itself at {where}: "
                "are its points in the right order?"
            )
        paths.append(path)
    rest = layout.nodes.rest_positions
    cables = Cables(tuple(paths), layout.nodes.free_index, rest, layout.nodes.carried)
    check_cables_move(cables, rest, layout.scene)
    return cables


def _cable_path(layout: Layout, cable, key: str, notes: list[str]):
    points = layout.carried(
        cable.body, layout.in_world(cable.body, cable.frame, cable.points), f"{key}.points",
        notes, cable.hold_radius,
    )  # fmt: skip
    pull_point = layout.in_world(cable.body, cable.frame, [cable.pull_point])
    if cable.pull_point_on == "world":
        return CablePath(cable.name, points, pull_point[0])
    if cable.pull_point_on == "body":
        start = layout.carried(
            cable.body, pull_point, f"{key}.pull_point", notes, cable.hold_radius
        )
    else:
        start = layout.carried(cable.pull_point_on, pull_point, f"{key}.pull_point", notes)
    return CablePath(cable.name, start.followed_by(points), None)


def effector_term(layout: Layout, notes: list[str]):
    """The effectors of a scene; see `cable_term`."""
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
        Their mapping, their ids, and for each effector the places of those that move with it.
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


def actuator_limits(scene: Scene, cables) -> ActuatorLimits:
    """What the actuators of a scene can do.

    Args:
        scene: The scene.
        cables: The cable term, or None. No cable is wound in by more than its length at rest.
    """
    slides = scene.slides
    lengths = np.empty(0) if cables is None else cables.rest_lengths
    rates = [entry.rate for entry in (*scene.cables, *slides)]
    pulls = np.array([cable.tension for cable in scene.cables]).reshape(-1, 2)
    wound = np.array([cable.shortening for cable in scene.cables]).reshape(-1, 2)
    free = np.full(len(slides), np.inf)
    # A slide that goes forward is wound out.
    travels = -np.array([slide.travel for slide in slides]).reshape(-1, 2)
    longest = np.where(np.isinf(wound[:, 1]), lengths, wound[:, 1])
    return ActuatorLimits(
        tuple(entry.name for entry in (*scene.cables, *slides)),
        np.concatenate([wound[:, 0], travels[:, 1]]),
        np.concatenate([longest, travels[:, 0]]),
        np.array([np.inf if rate is None else rate for rate in rates], float),
        np.concatenate([pulls[:, 0], -free]),
        np.concatenate([pulls[:, 1], free]),
    )
