"""Sensors: lengths, angles, volumes, pressures and forces of a state, and how they change with it.

A sensor of value m has one row h = ∂m/∂q. Where a target may be given for it, its row is one of the
inverse problem, in metres as those of effectors: ℓ m, with a length ℓ per unit of the sensor.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.constraints.constraint_term import ConstraintTerm
from softrobot_twin.constraints.contact import Contacts
from softrobot_twin.mechanics.barycentric import BarycentricMapping


class SensedTerm(NamedTuple):
    """Some sensors of one kind, by a constraint term whose rows are theirs but for zero and sign.

    Attributes:
        term: The term.
        zeros: Values where the rows of the term are zero, shape (count,).
        sign: Change of each value by its row, shape (count,) or one for all.
        lengths: ℓ of each [m per unit], shape (count,).
        spans: A large change of each, in its unit, shape (count,).
    """

    term: ConstraintTerm
    zeros: np.ndarray
    sign: float | np.ndarray
    lengths: np.ndarray
    spans: np.ndarray


class Sensors(ConstraintTerm):
    """Constraint term of sensors, in metres.

    Attributes:
        row_lengths: Length that counts as one step of LONGEST_TURN's unit of each row [m], shape
            (row_count,); see `InverseActuation.steps_to_targets`.
        row_weights: Weight of each as a target, shape (row_count,).
        lengths: ℓ of each [m per unit], same shape.
    """

    name = "sensors"
    group = "effectors"

    def __init__(self, parts: list[SensedTerm], weights: np.ndarray):
        """Put the terms one below the other.

        Args:
            parts: The sensors of each kind.
            weights: Weight of each as a target, shape (count,).
        """
        self._parts, self._places, first, entry = parts, [], 0, 0
        for part in parts:
            rows = slice(first, first + part.term.row_count)
            entries = slice(entry, entry + len(part.term.entry_rows))
            self._places.append((rows, entries))
            first, entry = rows.stop, entries.stop
        self.row_count, self.row_weights = first, np.asarray(weights, float)
        showing = [(rows, part.term) for part, (rows, _) in zip(parts, self._places) if part.term.shows_contacts]
        self.shows_contacts = bool(showing)
        self.contact_rows, self._showing = showing[0] if showing else (slice(0, 0), None)
        self.entry_rows = np.concatenate(
            [part.term.entry_rows + rows.start for part, (rows, _) in zip(parts, self._places)])
        self.entry_nodes = np.concatenate([part.term.entry_nodes for part in parts])
        self.lengths, spans = (np.concatenate([getattr(part, field) for part in parts])
                               for field in ("lengths", "spans"))
        self.row_lengths = self.lengths * spans

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H [m per m] and the values [m]; see `ConstraintTerm.evaluate`."""
        for part, (rows, entries) in zip(self._parts, self._places, strict=True):
            part.term.evaluate(positions, blocks[entries], values[rows])
            values[rows] = part.zeros + part.sign * values[rows]
            blocks[entries] *= np.broadcast_to(part.sign, len(part.zeros))[part.term.entry_rows, None]
        blocks *= self.lengths[self.entry_rows, None]
        values *= self.lengths

    def by_contacts(self) -> np.ndarray:
        """See `ConstraintTerm` [m/N]."""
        return self._showing.by_contacts() * self.lengths[self.contact_rows, None]

    def readings(self, positions: np.ndarray) -> np.ndarray:
        """What the sensors show, each in its unit, shape (row_count,).

        Args:
            positions: Node positions [m], shape (node_count, 3).
        """
        return self.rows_at(positions)[1] / self.lengths


class Bends(ConstraintTerm):
    """Rows of angles from one direction to another about fixed axes.

    With the vectors u and v between two points each, and the unit axis n, s = n · (u × v) and c the
    product of the parts of u and v across n,

        θ = atan2(s, c),    dθ = (c ds - s dc) / (s² + c²).
    """

    name = "bends"
    group = "effectors"

    def __init__(self, lines: list[BarycentricMapping], axes: np.ndarray, free_index: np.ndarray):
        """Take the points.

        Args:
            lines: Four points of each angle: the ends of u, then those of v.
            axes: n of each, shape (count, 3).
            free_index: Unknown or carried point of each node, -1 where fixed, shape (node_count,).
        """
        self._lines, self._axes, self.row_count = lines, axes, len(lines)
        self._entries = []
        rows, nodes = [], []
        for row, line in enumerate(lines):
            free = free_index[line.nodes]
            moves = (free >= 0) & (line.barycentric_weights != 0.0)
            points, places = np.nonzero(moves)
            self._entries.append((points, line.barycentric_weights[points, places]))
            rows.append(np.full(len(points), row))
            nodes.append(free[points, places])
        self.entry_rows, self.entry_nodes = np.concatenate(rows), np.concatenate(nodes)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H [rad/m] and the angles [rad]; see `ConstraintTerm.evaluate`."""
        first = 0
        for row, (line, axis, (points, weights)) in enumerate(zip(self._lines, self._axes, self._entries, strict=True)):
            places = line.positions(positions)
            u, v = places[1] - places[0], places[3] - places[2]
            u, v = u - (axis @ u) * axis, v - (axis @ v) * axis
            s, c = axis @ np.cross(u, v), u @ v
            values[row] = np.arctan2(s, c)
            by_u, by_v = (c * np.cross(v, axis) - s * v, c * np.cross(axis, u) - s * u)
            slopes = np.stack([-by_u, by_u, -by_v, by_v]) / (s * s + c * c)
            last = first + len(points)
            blocks[first:last] = weights[:, None] * slopes[points]
            first = last


class GasPressures(ConstraintTerm):
    """Rows of gauge pressures of sealed gas, by those of the volumes: dp = -p₀ V₀ / V² dV."""

    name = "gas pressures"
    group = "effectors"

    def __init__(self, volumes: ConstraintTerm, rest: np.ndarray, absolute: np.ndarray, ambient: np.ndarray):
        """Take the gas.

        Args:
            volumes: Term of which a row is the growth of a volume [m³].
            rest: V₀ of each [m³], shape (count,).
            absolute: p₀ of each [Pa], same shape.
            ambient: Pressure around each [Pa], same shape.
        """
        self._volumes, self._rest, self._ambient = volumes, rest, ambient
        self._work, self.row_count = absolute * rest, volumes.row_count
        self.entry_rows, self.entry_nodes = volumes.entry_rows, volumes.entry_nodes

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write H [Pa/m] and the gauge pressures [Pa]; see `ConstraintTerm.evaluate`."""
        self._volumes.evaluate(positions, blocks, values)
        volumes = values + self._rest
        blocks *= -(self._work / volumes**2)[self.entry_rows, None]
        values[:] = self._work / volumes - self._ambient


class PressingForces(ConstraintTerm):
    """Rows of the sums of normal forces of pairs: they follow from the forces, not from the positions."""

    name = "pressing forces"
    group = "effectors"
    shows_contacts = True

    def __init__(self, contacts: Contacts, pairs: list[tuple[str, str]]):
        """Take the pairs.

        Args:
            contacts: The contacts of the scene.
            pairs: Names of both bodies of each.
        """
        self._contacts, self._pairs, self.row_count = contacts, contacts.pairs_named(pairs), len(pairs)
        self.entry_rows = self.entry_nodes = np.empty(0, np.int64)

    def evaluate(self, positions: np.ndarray, blocks: np.ndarray, values: np.ndarray) -> None:
        """Write the forces of the last solution [N]; see `ConstraintTerm.evaluate`."""
        memory = self._contacts.memory
        values[:] = self._pairs @ np.bincount(memory.pairs, memory.forces[:, 0], self._pairs.shape[1])

    def by_contacts(self) -> np.ndarray:
        """See `ConstraintTerm`; shape (row_count, contact_row_count)."""
        contacts = self._contacts
        columns = np.zeros((self.row_count, contacts.row_count))
        columns[:, contacts.row_starts[:-1]] = self._pairs[:, contacts.pair[: contacts.count]]
        return columns
