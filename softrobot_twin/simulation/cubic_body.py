"""A scene's bodies with quadratic elements, and what cubic bubbles add to how they respond."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from time import perf_counter
from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.row_stack import RowStack
from softrobot_twin.geometry.cubic_bubbles import add_bubbles
from softrobot_twin.mechanics.cubic_correction import CubicCorrection, CubicPart
from softrobot_twin.mechanics.material import lame_parameters
from softrobot_twin.simulation.actuators import build_groups
from softrobot_twin.simulation.constraint_building import effector_term
from softrobot_twin.simulation.newton import Newton
from softrobot_twin.simulation.scene_layout import lay_out
from softrobot_twin.simulation.still_scene import MeshErrorUnknown
from softrobot_twin.simulation.time_budget import StageClock

LEFT_OUT = 0.36
"""What cubic elements leave out, as a share of what they add to quadratic ones."""
LEFT_OUT_AT_CABLES = 0.46
"""The same of the way that a cable's own tension winds it in."""
# A load that moves the effectors by less than this share of the body's largest motion does not
# drive them; what is left of them is mostly the mesh's lack of symmetry.
_DRIVES = 0.02


class Response(NamedTuple):
    """What moves when forces act: compliances of a body at rest.

    Attributes:
        gravity: Motion of the effector rows under gravity [m], shape (effector_row_count,).
        W_ea: By each cable's tension [m/N], shape (effector_row_count, cable_count).
        W_aa: Shortening of each cable by its own tension [m/N], shape (cable_count,).
        drives: What a load must move the effectors by to count; 0 unless known [m, m/N],
            shape (1 + cable_count,).
    """

    gravity: np.ndarray
    W_ea: np.ndarray
    W_aa: np.ndarray
    drives: np.ndarray


def limit(quadratic: Response, cubic: Response) -> Response:
    """What the responses tend to: cubic elements leave out a share of what they add."""
    return Response(
        cubic.gravity + LEFT_OUT * (cubic.gravity - quadratic.gravity),
        cubic.W_ea + LEFT_OUT * (cubic.W_ea - quadratic.W_ea),
        cubic.W_aa + LEFT_OUT_AT_CABLES * (cubic.W_aa - quadratic.W_aa),
        cubic.drives,
    )  # fmt: skip


class CubicBody:
    """The quadratic body, and what its bubbles add."""

    def __init__(self, model):
        self._model, self._newton = model, Newton(model)
        layout = lay_out(model.scene, [])
        parts, bodies, held, bubble_count = [], [], [], 0
        node_count = len(layout.nodes.rest_positions)
        for body in layout.bodies:
            mesh = add_bubbles(body.mesh, node_count + bubble_count - body.first_node)
            bubble_count += len(mesh.bubble_corners)
            held.append(body.fixed[mesh.bubble_corners].all(axis=1))
            material = body.entry.material
            lame = lame_parameters(material.young_modulus, material.poisson_ratio)
            turns = material.law != "linear"
            parts.append(CubicPart(mesh, body.first_node, lame, body.density, turns))
            bodies.append(replace(body, mesh=mesh))
        held = np.concatenate(held)
        places = np.where(held, -1, np.cumsum(~held) - 1)
        unknowns = model.nodes.free_node_count
        index = np.where(places >= 0, unknowns + places, -1)
        free = np.where(layout.nodes.free_index < unknowns, layout.nodes.free_index, -1)
        self._correction = CubicCorrection(parts, np.concatenate([free, index]), unknowns)
        # Rows of the bubbles alone: what they hold of the nodes is the model's.
        self._bubbles = np.zeros((bubble_count, 3))
        nodes = replace(
            layout.nodes, free_index=np.concatenate([np.full(node_count, -1), places]),
            rest_positions=np.vstack([layout.nodes.rest_positions, self._bubbles]), kinds=(),
        )  # fmt: skip
        widened = layout._replace(bodies=tuple(bodies), nodes=nodes)
        terms = [group.term for group in build_groups(widened, [])]
        self._rows = RowStack([*terms, effector_term(widened, [])])
        self._cable_count = model.actuators.row_count

    def responses(self) -> tuple[Response, Response]:
        """Of the quadratic body and of the cubic one, at rest."""
        model, correction = self._model, self._correction
        rest, gravity = model.nodes.rest_positions, np.array(model.scene.gravity)
        quadratic = response(self._newton, model)
        still = correction.linearize(rest)
        solve = model.factorization.solve
        forces = np.zeros((model.nodes.free_node_count, 3))
        for term in model.forces:
            term.add_forces(rest, forces)
        rows = self._left_rows(rest)
        weight = correction.left_on_bubbles(
            still + correction.weight(gravity), solve(forces)
        )
        loads = [weight if gravity.any() else None, *rows[: self._cable_count]]
        moved = [np.zeros_like(still) if load is None else correction.solve(load, solve)
                 for load in loads]  # fmt: skip
        cables, effectors = rows[: self._cable_count], rows[self._cable_count :]
        added = np.array([[np.vdot(row, move) for move in moved] for row in effectors])
        wound = [np.vdot(row, move) for row, move in zip(cables, moved[1:], strict=True)]
        cubic = Response(
            quadratic.gravity + added[:, 0], quadratic.W_ea + added[:, 1:],
            quadratic.W_aa + np.array(wound), quadratic.drives,
        )  # fmt: skip
        return quadratic, cubic

    def _left_rows(self, positions: np.ndarray) -> list[np.ndarray]:
        """Force of each row's multiplier on the bubbles that the nodes leave, [1]."""
        model, count = self._model, self._model.nodes.free_node_count
        model.rows.evaluate(positions)
        self._rows.evaluate(np.vstack([positions, self._bubbles]))
        solve, shape = model.factorization.solve, (self._correction.bubble_count, 3)
        left = []
        for row in range(self._rows.row_count):
            on_nodes, on_bubbles = np.zeros((count, 3)), np.zeros(shape)
            multipliers = np.zeros(self._rows.row_count)
            multipliers[row] = 1.0
            model.rows.add_forces(multipliers, on_nodes)
            self._rows.add_forces(multipliers, on_bubbles)
            left.append(self._correction.left_on_bubbles(on_bubbles, solve(on_nodes)))
        return left

    def addition(self, state, lengths_given: bool) -> np.ndarray:
        """What cubic elements add to the effector rows at an equilibrium of the quadratic [m].

        Args:
            state: The state.
            lengths_given: Whether taut cables keep their lengths, or all their tensions.

        Returns:
            The way of each effector row [m]; NaN where no factor was found, shape
            (effector_row_count,).
        """
        model, correction, count = self._model, self._correction, self._cable_count
        clock = StageClock(perf_counter)
        linear = self._newton.linearize(state.positions.copy(), state.efforts, clock)
        if linear is None:
            return np.full(self._rows.row_count - count, np.nan)
        forces = correction.linearize(state.positions)
        forces += correction.weight(np.array(model.scene.gravity))
        rows = self._left_rows(state.positions)
        multipliers = np.zeros(self._rows.row_count)
        multipliers[:count] = state.efforts[:count]
        self._rows.add_forces(multipliers, forces)
        solve = model.factorization.solve
        moved = correction.solve(forces, solve)
        cables, effectors = rows[:count], rows[count:]
        added = np.array([np.vdot(row, moved) for row in effectors])
        taut = np.flatnonzero(state.efforts[:count] > 0.0)
        if not (lengths_given and len(taut)):
            return added
        # The tensions that keep the lengths follow from the quadratic body's own compliance.
        wound = np.array([np.vdot(cables[cable], moved) for cable in taut])
        # Cables that run alike share what keeps them; how, the effectors do not see.
        change = np.linalg.lstsq(linear.W_aa[np.ix_(taut, taut)], wound, rcond=None)[0]
        return added - linear.W_ea[:, taut] @ change


def response(newton: Newton, model) -> Response:
    """Compliances at rest, by one linearization."""
    rest = model.nodes.rest_positions.copy()
    linear = newton.linearize(rest, np.zeros(len(model.actuators.names)), StageClock(perf_counter))
    if linear is None or newton.projected_tangent:
        raise MeshErrorUnknown("the body has no stable equilibrium at rest")
    # `expand` gives the same memory each time.
    moves = [model.factorization.expand(load).copy() for load in _unit_loads(model)]
    largest = [float(np.linalg.norm(move, axis=1).max()) for move in _differences(moves)]
    return Response(
        linear.effectors - linear.effectors_now, linear.W_ea, np.diag(linear.W_aa).copy(),
        _DRIVES * np.array(largest),
    )  # fmt: skip


def _unit_loads(model) -> Iterable[np.ndarray]:
    """Multipliers of no load but gravity, and of each cable pulled with one newton beside it."""
    count = model.rows.row_count
    yield np.zeros(count)
    for cable in range(len(model.actuators.names)):
        yield np.eye(1, count, cable)[0]


def _differences(moves: Iterable[np.ndarray]) -> list[np.ndarray]:
    """The first move, and what each of the others adds to it."""
    first, *others = moves
    return [first, *(move - first for move in others)]
