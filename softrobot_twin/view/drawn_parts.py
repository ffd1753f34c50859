"""What is drawn beside deformable bodies: rigid bodies, obstacles, cavities, springs, and what is fixed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from softrobot_twin.mechanics.reduced_points import ReducedPoints
from softrobot_twin.mechanics.sealed_gas import SealedGas
from softrobot_twin.mechanics.springs import Springs
from softrobot_twin.simulation import Simulation, State
from softrobot_twin.simulation.appearance import Skin
from softrobot_twin.simulation.building.beam_bodies import BeamBody
from softrobot_twin.simulation.building.cavity_actuator import CavityActuator
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.scene_layout import FACETS, triangulated

# A plane is shown as a square that extends this many scene sizes to each side.
PATCH = 1.5


class SolidSkin(NamedTuple):
    """The surface of something rigid.

    Attributes:
        name: The name of the body or obstacle.
        points: Its points [m], shape (point_count, 3).
        triangles: Indices of them, shape (triangle_count, 3).
    """

    name: str
    points: np.ndarray
    triangles: np.ndarray


def rigid_skins(model: Model, facets: float = FACETS) -> tuple[SolidSkin, ...]:
    """The rigid bodies, each in the coordinates of its scene entry.

    Args:
        model: The built scene.
        facets: Length of the facets of round shapes, as a share of their radius.

    Returns:
        A surface for each.
    """
    shapes = ((part, *triangulated(part.shape, facets)) for part in model.rigid)
    return tuple(SolidSkin(part.name, points + part.centre_of_mass, triangles)
                 for part, points, triangles in shapes)  # fmt: skip


def obstacle_skins(model: Model, facets: float = FACETS) -> tuple[SolidSkin, ...]:
    """The obstacles, in the world; of a plane, a square beside the bodies.

    Args:
        model: The built scene.
        facets: Length of the facets of round shapes, as a share of their radius.

    Returns:
        A surface for each.

    Raises:
        MeshError: A surface file cannot be used.
    """
    skins = []
    for entry in model.scene.obstacles:
        # Repairs of its file are reported when the contact is built.
        shape = entry.shape.solid(model.scene.file_path, [])
        if entry.plane is not None:
            points, triangles = shape.square(_middle(entry, model), PATCH * model.nodes.size)
        else:
            points, triangles = triangulated(shape, facets)
        turn = Rotation.from_euler("xyz", entry.rotation)
        skins.append(SolidSkin(entry.name, turn.apply(points) + entry.position, triangles))
    return tuple(skins)


def _middle(entry, model: Model) -> np.ndarray:
    """Middle of the bodies in the coordinates of an obstacle [m], shape (3,)."""
    middle = model.nodes.rest_positions[_body_nodes(model)].mean(axis=0)
    return Rotation.from_euler("xyz", entry.rotation).inv().apply(middle - entry.position)


def _body_nodes(model: Model) -> np.ndarray:
    """Nodes that are points of bodies; tips of rigid bodies' frames and coordinates are not."""
    are_points = np.ones(len(model.nodes.rest_positions), bool)
    for kind in model.nodes.kinds:
        if isinstance(kind, ReducedPoints):
            are_points[kind.coordinate_nodes] = False
        else:
            tips = kind.first_node + np.arange(len(are_points) - kind.first_node)
            are_points[tips[np.arange(len(tips)) % 4 != 0]] = False
    return np.flatnonzero(are_points)


def fixed_places(body: Body, node_positions: np.ndarray) -> np.ndarray:
    """Places of the fixed nodes on a body's surface.

    Nodes that move with a rigid body are not among them.

    Args:
        body: The body.
        node_positions: Node positions [m], shape (node_count, 3).

    Returns:
        Positions [m], shape (fixed_count, 3).
    """
    fixed = body.whole.fixed.copy()
    for nodes in body.riding.values():
        fixed[nodes] = False
    nodes = np.intersect1d(np.flatnonzero(fixed), body.mesh.surface_triangles)
    if not len(nodes):
        return np.empty((0, 3))
    return body.shown_nodes(nodes).positions(node_positions)


def fixed_ends(beams: tuple[BeamBody, ...]) -> np.ndarray:
    """Places of the fixed ends of beams [m], shape (fixed_count, 3).

    Args:
        beams: The beams.
    """
    ends = [beam.places[0 if end == "start" else -1] for beam in beams for end in beam.entry.fixed]
    return np.array(ends, float).reshape(-1, 3)


class CavityDisplay:
    """What is drawn of cavities: walls, pressures and volumes; sealed ones come last.

    Attributes:
        skins: Walls of each cavity.
    """

    def __init__(self, model: Model):
        """Find the cavities.

        Args:
            model: The built scene.
        """
        actuators = model.actuators
        self._driven = actuators.of_section(CavityActuator.section)
        self._gas = [term for term in model.forces if term.name == SealedGas.name]
        groups = [group for group in actuators.groups
                  if group.kind.section == CavityActuator.section]  # fmt: skip
        skins = [Skin(surface.name, surface.triangles, surface.vertices, tuple(limits))
                 for group in groups
                 for surface, limits in zip(group.term.surfaces, group.effort_bounds, strict=True)]  # fmt: skip
        self._walls = [group.term.walls for group in groups]
        for gas in self._gas:
            self._walls.append(gas.walls)
            skins += [Skin(surface.name, surface.triangles, surface.vertices) for surface in gas.walls.surfaces]
        self.skins = tuple(skins)

    def positions(self, state: State) -> tuple[np.ndarray, ...]:
        """Points of the walls of each cavity [m], each of shape (point_count, 3).

        Args:
            state: The state.
        """
        return tuple(skin.positions(state.positions) for skin in self.skins)

    def pressures(self, state: State) -> np.ndarray:
        """Gauge pressures [Pa], shape (cavity_count,).

        Args:
            state: The state.
        """
        sealed = (gas.pressures(state.positions) for gas in self._gas)
        return np.concatenate([state.efforts[self._driven], *sealed])

    def volumes(self, state: State) -> np.ndarray:
        """Volumes [m³], shape (cavity_count,).

        Args:
            state: The state.
        """
        return np.concatenate([np.empty(0), *(walls.volumes(state.positions)
                                              for walls in self._walls)])  # fmt: skip


def spring_places(simulation: Simulation) -> dict[str, np.ndarray]:
    """Masses on points, springs, and tubes and fibres, which are threads, where there are any.

    Args:
        simulation: The simulation.

    Returns:
        Points of each ``mass`` [m], shape (mass_count, 3), and both ends of each ``thread`` and
        ``spring``, shape (count, 2, 3); what the scene has none of is left out.
    """
    scene, model, node_positions = simulation.scene, simulation.model, simulation.state.positions
    first = sum(body.scene_node_count for body in model.bodies)
    masses = node_positions[first : first + sum(len(entry.points) for entry in scene.mass_springs)]
    ends = np.concatenate([np.empty((0, 2, 3)), *(term.ends(node_positions) for term in model.terms
                                                  if type(term) is Springs)])  # fmt: skip
    # Those of the scene's springs come first, those of its masses last; threads between.
    first, last = len(scene.springs), len(ends) - sum(len(one.springs) for one in scene.mass_springs)
    springs = np.concatenate([ends[:first], ends[last:]])
    found = {"mass": masses, "thread": ends[first:last], "spring": springs}
    return {kind: places for kind, places in found.items() if len(places)}
