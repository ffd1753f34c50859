"""What a scene looks like at one state, as triangles: everything that it holds, nothing drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.scene.shapes import PlaneShape
from softrobot_twin.simulation.scene_layout import build_shape
from softrobot_twin.study.reports import depth_sorted

if TYPE_CHECKING:
    from softrobot_twin.simulation import Simulation
    from softrobot_twin.simulation.contact_forces import ContactForces

BODY_COLOUR = np.array([0.60, 0.78, 0.84])
FREE_COLOUR = np.array([0.93, 0.73, 0.42])
GUIDED_COLOUR = np.array([0.72, 0.72, 0.74])
OBSTACLE_COLOUR = np.array([0.80, 0.79, 0.75])
SPRING_COLOUR = np.array([0.45, 0.45, 0.50])
PULL_POINT_COLOUR = np.array([0.30, 0.30, 0.30])
EFFECTOR_COLOUR = np.array([0.10, 0.25, 0.45])
TARGET_COLOUR = np.array([0.85, 0.22, 0.15])
# Round shapes are cut into facets this share of their radius long.
_FACETS = 0.2
# Edges at which a rigid surface turns by more than this [rad] are drawn.
_SHARP = 0.6
# Rigid triangles are cut to this share of the scene's size: large ones cannot be sorted by depth.
_LONGEST_EDGE = 0.04


class Solid(NamedTuple):
    """Triangles of one colour.

    Attributes:
        triangles: Corners [m], shape (triangle_count, 3, 3).
        colour: Red, green, blue in 0..1, shape (3,).
        look: ``mesh`` with its edges and deep shadows, ``rigid`` without edges, ``thin`` with
            faint shadows.
    """

    triangles: np.ndarray
    colour: np.ndarray
    look: str


class CableLine(NamedTuple):
    """A cable: its points [m], shape (point_count, 3), and its tension [N]."""

    points: np.ndarray
    tension: float


class Snapshot(NamedTuple):
    """One state, ready to be drawn.

    Attributes:
        title: What stands above it.
        size: Size of the largest body [m], by which thin things are scaled.
        solids: Bodies, rigid bodies, obstacles, springs, effectors and targets.
        cables: Cables.
        planes: Point [m] and unit normal of each plane.
        forces: Where contact forces act [m] and the forces on the first body [N], both of shape
            (contact_count, 3).
        has_effectors: Effectors are among the solids.
        has_targets: Targets are among the solids.
        trail: Where the effectors have been [m], shape (row_count, effector_count, 3), or None.
    """

    title: str
    size: float
    solids: list[Solid]
    cables: list[CableLine]
    planes: list[tuple[np.ndarray, np.ndarray]]
    forces: tuple[np.ndarray, np.ndarray]
    has_effectors: bool
    has_targets: bool
    trail: np.ndarray | None


def take(simulation: Simulation, contacts: ContactForces | None, title: str,
         targets: np.ndarray | None = None, trail: np.ndarray | None = None) -> Snapshot:
    """Looks at a simulation's present state.

    Args:
        simulation: Where it stands now is what is seen.
        contacts: What its last step found touching, or None.
        title: What to write above it.
        targets: Where the effectors should be [m], shape (effector_count, 3); NaN for none.
        trail: Where the effectors have been [m], shape (row_count, effector_count, 3).
    """
    size = simulation.model.nodes.size
    effectors = simulation.effector_positions()
    shown = [] if targets is None else [t for t in targets if np.isfinite(t).all()]
    solids = [*_bodies(simulation), *_rigid(simulation, size), *_springs(simulation, size)]
    obstacles, planes = _obstacles(simulation, size)
    solids += obstacles
    solids += [Solid(depth_sorted.sphere(point, 0.014 * size), EFFECTOR_COLOUR, "thin")
               for point in effectors]
    solids += [Solid(depth_sorted.cross(point, 0.08 * size, 0.0035 * size), TARGET_COLOUR, "thin")
               for point in shown]
    paths = simulation.cable_paths()
    # Below the cables' tensions stand the forces of slides.
    cables = [CableLine(path, float(tension)) for path, tension in zip(
        paths, simulation.state.efforts[:len(paths)], strict=True)]
    nothing = np.empty((0, 3))
    forces = (nothing, nothing) if contacts is None else (contacts.positions, contacts.forces)
    return Snapshot(title, size, solids, cables, planes, forces, bool(len(effectors)),
                    targets is not None, trail)


def _bodies(simulation: Simulation) -> list[Solid]:
    if not len(simulation.surface_triangles):
        return []
    surface = simulation.surface_positions()
    return [Solid(surface[simulation.surface_triangles], BODY_COLOUR, "mesh")]


def _rigid(simulation: Simulation, size: float) -> list[Solid]:
    solids = []
    for part in simulation.model.rigid:
        frame = simulation.state.positions[part.first_node : part.first_node + 4]
        colour = FREE_COLOUR if part.is_free else GUIDED_COLOUR
        solids += _solid_shape(part.shape, frame[0], (frame[1:] - frame[0]).T, colour, size)
    return solids


def _solid_shape(shape, origin, rotation, colour: np.ndarray, size: float) -> list[Solid]:
    """A rigid shape and its sharp edges."""
    points, triangles = shape.surface(_FACETS * getattr(shape, "radius", np.inf))
    placed = np.asarray(origin) + points @ rotation.T
    solids = [Solid(depth_sorted.cut(placed[triangles], _LONGEST_EDGE * size), colour, "rigid")]
    for edge in depth_sorted.creases(placed, triangles, _SHARP):
        bar = depth_sorted.tube(edge, 0.002 * size, 0.015 * size)
        solids.append(Solid(bar, 0.7 * colour, "thin"))
    return solids


def _obstacles(simulation: Simulation, size: float) -> tuple[list[Solid], list[tuple]]:
    scene, solids, planes = simulation.scene, [], []
    for entry in scene.obstacles:
        turn = Rotation.from_euler("xyz", entry.rotation).as_matrix()
        shape = build_shape(entry.shape, scene, [])
        if isinstance(entry.shape, PlaneShape):
            planes.append((entry.position + turn @ shape.point, turn @ shape.normal))
            continue
        solids += _solid_shape(shape, entry.position, turn, OBSTACLE_COLOUR, size)
    return solids, planes


def _springs(simulation: Simulation, size: float) -> list[Solid]:
    """Mass-spring bodies: balls at their points, bars for their springs."""
    solids = []
    first = sum(body.mesh.node_count for body in simulation.model.bodies)
    for entry in simulation.scene.mass_springs:
        points = simulation.state.positions[first : first + len(entry.points)]
        first += len(entry.points)
        solids += [Solid(depth_sorted.sphere(point, 0.012 * size), SPRING_COLOUR, "rigid")
                   for point in points]
        solids += [Solid(depth_sorted.tube(points[list(pair)], 0.004 * size, 0.02 * size),
                         SPRING_COLOUR, "thin") for pair in entry.springs]
    return solids
