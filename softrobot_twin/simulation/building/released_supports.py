"""Forces on what does not move by itself: the terms of a scene again, with its supports released.

The terms of a model leave out what acts on fixed and guided nodes, which have no unknowns. Here each of
them has: every node of a deformable body or point mass is free, also where it is attached, and every
frame has a translation and a rotation. Nothing is solved with these unknowns. At a state of the model

    p - F(q) + Hᵀλ

is zero at what the model moves, and on a support it is the force that the bodies exert there.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.mechanics.force_term import ForceTerm
from softrobot_twin.mechanics.kinematics import on_unknowns
from softrobot_twin.mechanics.touch_loads import TouchLoads
from softrobot_twin.scene.schema import Reaction
from softrobot_twin.simulation.building.actuators import Actuators, build_actuators
from softrobot_twin.simulation.building.deformable_body import Body
from softrobot_twin.simulation.building.force_building import body_motion_terms, static_terms
from softrobot_twin.simulation.building.model import Model
from softrobot_twin.simulation.building.scene_layout import Layout, frame_nodes, lay_out


class Support(NamedTuple):
    """What holds a part.

    Attributes:
        nodes: Nodes that it holds, shape (count,).
        frames: Origin nodes of the frames that it holds, shape (frame_count,).
        about: Where torques are taken about [m], shape (3,); None for the mean of its frames, or nodes.
    """

    nodes: np.ndarray
    frames: np.ndarray
    about: np.ndarray | None


class ReleasedSupports:
    """The forces on the supports that a scene names.

    Attributes:
        forces: Force terms, on released unknowns.
        actuators: The actuators, likewise.
    """

    forces: tuple[ForceTerm, ...]
    actuators: Actuators

    def __init__(self, model: Model):
        """Build the terms.

        Args:
            model: The model of a scene.

        Raises:
            SceneError: A part is held by nothing, or is reduced.
        """
        scene = model.scene
        drawn = lay_out(scene, [], mounted=model.nodes.rest_positions if scene.mounting else None)
        self.supports = [_support(drawn, entry, key) for key, entry in scene.keyed("reactions")]
        layout = _released(drawn)
        nodes = self._nodes = layout.nodes
        moving = body_motion_terms(layout) if scene.integration != "quasi_static" else ()
        # Of rigid bodies and beams inertia acts on their own unknowns alone.
        terms = (*static_terms(layout, []), *moving)
        self.actuators = build_actuators(layout, [])
        self.forces = (*(on_unknowns(term, nodes.carried) for term in terms), *self.actuators.held_forces)
        ranks = np.arange(nodes.free_node_count)
        for term in (*self.forces, *self.actuators.terms):
            term.bind(ranks, lambda rows, columns: np.zeros((2, *np.shape(rows)), np.int64))
        self._rows = RowStack(self.actuators.terms, nodes.carried)
        self._touches, self._touched = (
            next((term for term in terms if isinstance(term, TouchLoads)), None)
            for terms in ((term.on_points for term in self.forces), model.forces)
        )  # fmt: skip
        self._contacts: Contacts | None = model.contacts
        own = (nodes.free_index >= 0) & (nodes.free_index < nodes.free_node_count)
        self._own, self._unknowns = np.flatnonzero(own), nodes.free_index[own]
        index = model.nodes.free_index[self._own]
        self._moved = np.where((index >= 0) & (index < model.nodes.free_node_count), index, -1)
        self._held = np.ones_like(nodes.rest_positions)
        for body in drawn.bodies:
            self._held[body.first_node : body.first_node + len(body.held)] = body.held

    def begin_step(
        self, before: np.ndarray, after: np.ndarray, velocities: np.ndarray, time_step: float
    ) -> None:
        """Let terms that remember the beginning of a step look at it.

        Nodes that do not move by themselves count as unaccelerated, as in the model.

        Args:
            before: Node positions there [m], shape (node_count, 3).
            after: Those at the end of the step [m], same shape.
            velocities: Of the unknowns of the model there [m/s], shape (free_node_count, 3).
            time_step: h [s].
        """
        started = np.zeros((self._nodes.free_node_count, 3))
        if len(velocities):
            steady = (after - before)[self._own] / time_step
            started[self._unknowns] = np.where(self._moved[:, None] >= 0, velocities[self._moved], steady)
        for term in self.forces:
            if term.remembers_start:
                term.begin_step(before, started, time_step)

    def wrenches(self, positions: np.ndarray, efforts: np.ndarray) -> np.ndarray:
        """Force [N] and torque [N m] of each support on what it holds.

        Args:
            positions: Node positions [m], shape (node_count, 3).
            efforts: Efforts of the actuators, in their units, shape (actuator_count,).

        Returns:
            Shape (support_count, 6).
        """
        if self._touches:
            fields = "loads", "places", "is_held", "is_active"
            vars(self._touches).update({name: getattr(self._touched, name) for name in fields})
        forces, rows = np.zeros((self._nodes.free_node_count, 3)), self._rows
        rows.tell_efforts(efforts)
        for term in self.forces:
            term.add_forces(positions, forces)
        rows.evaluate(positions)
        rows.add_forces(efforts[: rows.row_count], forces)
        at_nodes = np.zeros_like(positions)
        at_nodes[self._own] = forces[self._unknowns]
        if self._contacts:
            _add_contacts(self._contacts, at_nodes)
        at_nodes *= self._held
        return -np.array([self._wrench(one, positions, forces, at_nodes) for one in self.supports])

    def _wrench(
        self, support: Support, positions: np.ndarray, forces: np.ndarray, at_nodes: np.ndarray
    ) -> np.ndarray:
        """Force and torque of the bodies on a support, shape (6,)."""
        nodes = np.concatenate([support.nodes, (support.frames[:, None] + np.arange(4)).ravel()])
        pushes, places = at_nodes[nodes], positions[nodes]
        twists = np.zeros(3)
        if len(support.frames):
            first = self._nodes.kinds[0].unknowns_of(support.frames)
            pushes = np.concatenate([pushes, forces[first]])
            places = np.concatenate([places, positions[support.frames]])
            twists = forces[first + 1].sum(axis=0)
        held = positions[support.frames if len(support.frames) else support.nodes]
        about = held.mean(axis=0) if support.about is None else support.about
        torque = twists + np.cross(places - about, pushes).sum(axis=0)
        return np.concatenate([pushes.sum(axis=0), torque])


def _released(layout: Layout) -> Layout:
    """The layout with an unknown for each node that is none of a frame, and for each frame."""
    nothing = np.empty(0, np.int64), np.empty((0, 3))
    parts = [replace(part, is_free=True, attached=nothing[0], local=nothing[1]) for part in layout.framed]
    count = layout.nodes.kinds[0].first_node if parts else len(layout.nodes.rest_positions)
    every = np.arange(count)
    nodes = frame_nodes(
        layout.nodes.rest_positions[:count], every, every.copy(), [layout.nodes.finite_size],
        tuple(parts),
    )  # fmt: skip
    nodes = replace(nodes, rest_positions=layout.nodes.rest_positions)
    bodies = tuple(replace(body, fixed=np.zeros_like(body.fixed)) for body in layout.bodies)
    rigid = tuple(parts[: len(layout.rigid)])
    return layout._replace(bodies=bodies, nodes=nodes, rigid=rigid, beam_frames=tuple(parts[len(rigid):]))


def _support(layout: Layout, entry: Reaction, key: str) -> Support:
    """What an entry names.

    Raises:
        SceneError: Nothing holds the part there, or it is reduced.
    """
    scene, index = layout.scene, layout.nodes.free_index
    reduced = [body.name for body in layout.bodies if body.is_reduced]
    if reduced or layout.hinged is not None:
        what = f"the reduced body {reduced[0]}" if reduced else "beams with hinges"
        raise scene.error(key, entry.name, f"reactions are not built beside {what}")
    if scene.time_scheme != "backward_euler":
        raise scene.error("time_scheme", scene.time_scheme, "is not built beside reactions")
    none = np.empty(0, np.int64)
    nodes, frames = none, none
    if entry.of in layout.mass_nodes:
        nodes = layout.mass_nodes[entry.of]
        nodes = nodes[index[nodes] < 0]
    elif isinstance(body := layout.body_named(entry.of), Body):
        riding = body.riding
        if not entry.attached_to:
            ridden = np.concatenate([none, *riding.values()])
            nodes = np.setdiff1d(np.flatnonzero(body.held.any(axis=1)), ridden) + body.first_node
        elif entry.attached_to in riding:
            nodes = riding[entry.attached_to] + body.first_node
    elif body in layout.beams:
        frames = np.unique(body.carriers.frame_nodes[index[body.carriers.frame_nodes] < 0])
        frames = frames[frames >= layout.nodes.kinds[0].first_node + 4 * len(layout.rigid)]
    elif not body.is_free:
        frames = np.array([body.first_node])
        riders = [one.riding[body.name] + one.first_node for one in layout.bodies if body.name in one.riding]
        nodes = np.concatenate([none, *riders])
    if not len(nodes) and not len(frames):
        to = f" to {entry.attached_to}" if entry.attached_to else ""
        raise scene.error(f"{key}.of", entry.of, f"is not held{to} at any node: nothing reacts")
    about = np.array(entry.about) if entry.about else None
    return Support(nodes, frames, about)


def _add_contacts(contacts: Contacts, at_nodes: np.ndarray) -> None:
    """Add the forces of the last solution to those at nodes [N], shape (node_count, 3)."""
    count, forces = contacts.count, contacts.memory.forces
    pushes = np.einsum("cr,cri->ci", forces, contacts.directions[:count, : forces.shape[1]])
    nodes, coefficients = contacts.nodes[:count], contacts.coefficients[:count]
    used = nodes >= 0
    shares = coefficients[:, :, None] * pushes[:, None, :]
    np.add.at(at_nodes, nodes[used], shares[used])
