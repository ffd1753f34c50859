"""Stiffness against hour-glass modes of the sampled hexahedra of a body in the coordinates of a basis.

A cell has 21 rows by the coordinates q: nine of F and twelve of h; see `hourglass.py` for the energy, and
`reduced_elements.py` for the coordinates. Its weight is that of its point.

Arguments of the kernels here:
    rows: Rows of all cells in the order of the batches, shape (batch_count, 21, BATCH, mode_count).
    states: F and h, shape (batch_count, 21 × BATCH).
    y, g, start, moduli, scale, floor, is_linear: See `hourglass.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from softrobot_twin.geometry.shape_functions import HourglassFields
from softrobot_twin.geometry.vector_arrays import multiply_transposed
from softrobot_twin.kernels.compilation import KERNEL, njit
from softrobot_twin.mechanics.element_batches import BATCH, at, scratch
from softrobot_twin.mechanics.hourglass import (
    VECTORS,
    add_energies,
    differentiate,
    divided_moduli,
    find_state,
    flat_batches,
    hourglass_moduli,
    strain,
    stresses,
    write_forces,
)
from softrobot_twin.mechanics.material import LameParameters

ROWS = 9 + 3 * VECTORS
FAST = {**KERNEL, "fastmath": True}
"""Options of sums that vector instructions may take in another order."""


class HourglassRows(NamedTuple):
    """What sampled hexahedra need beside the gradients of their points.

    Attributes:
        rows: h by the coordinates, shape (count, 12, mode_count).
        fields: Of the cells.
        weights: What their moduli are multiplied by, shape (count,).
    """

    rows: np.ndarray
    fields: HourglassFields
    weights: np.ndarray


@njit(**FAST)
def measure(rows, coordinates, states):
    """F and h of all cells.

    Args:
        rows, states: As above; states are written.
        coordinates: q [m], shape (mode_count,).
    """
    for k in range(len(rows)):
        for r in range(rows.shape[1]):
            for e in range(BATCH):
                total = 1.0 if r < 9 and r % 4 == 0 else 0.0
                for m in range(len(coordinates)):
                    total += rows[k, r, e, m] * coordinates[m]
                states[k, at(r, e)] = total


@njit(**KERNEL)
def find_strains(is_linear, states, y):
    """y of all cells.

    Args:
        is_linear, states: As above.
        y: Takes y [m], shape (batch_count, 12 × BATCH).
    """
    C, factors = scratch(9), scratch(3)
    for k in range(len(states)):
        find_state(is_linear, states[k, : 9 * BATCH], C, factors)
        strain(C, factors, states[k, 9 * BATCH :], y[k])


@njit(**KERNEL)
def find_stresses(is_linear, floor, states, g, found):
    """P of all cells.

    Args:
        is_linear, floor, states, g: As above.
        found: Takes P, shape (batch_count, 21 × BATCH).
    """
    C, factors = scratch(9), scratch(3)
    for k in range(len(states)):
        F, h = states[k, : 9 * BATCH], states[k, 9 * BATCH :]
        find_state(is_linear, F, C, factors)
        stresses(is_linear, F, C, factors, h, g[k], floor[k], found[k])


@njit(**FAST)
def add_forces(rows, found, forces):
    """Add Σ rowsᵀ P.

    Args:
        rows: As above.
        found: P, shape (batch_count, 21 × BATCH).
        forces: On the coordinates [N], shape (mode_count,); added to.
    """
    for k in range(len(rows)):
        for r in range(rows.shape[1]):
            for e in range(BATCH):
                value, row = found[k, at(r, e)], rows[k, r, e]
                for m in range(len(row)):
                    forces[m] += value * row[m]


@njit(**FAST)
def write_changes(is_linear, moduli, scale, floor, rows, states, g, projected, changes):
    """∂P by the coordinates of all cells, the shape of `rows`.

    Args:
        is_linear, moduli, scale, floor, rows, states, g: As above.
        projected: True for the positive semidefinite part.
        changes: Written.
    """
    C, factors, dC, dF = scratch(9), scratch(3), scratch(9), scratch(9)
    dh, dy, dg, force, dP = scratch(12), scratch(12), scratch(12), scratch(12), scratch(21)
    for k in range(len(states)):
        F, h = states[k, : 9 * BATCH], states[k, 9 * BATCH :]
        find_state(is_linear, F, C, factors)
        for i in range(len(force)):
            force[i] = 0.0 if projected else g[k, i]
        changes[k] = 0.0
        for s in range(rows.shape[1]):
            dF[:], dh[:] = 0.0, 0.0
            for e in range(BATCH):
                if s < 9:
                    dF[at(s, e)] = 1.0
                else:
                    dh[at(s - 9, e)] = 1.0
            differentiate(
                is_linear, F, C, factors, h, force, moduli[k], scale[0], floor[k], dF, dh, dC, dy, dg, dP
            )
            for r in range(rows.shape[1]):
                for e in range(BATCH):
                    factor, own, row = dP[at(r, e)], changes[k, r, e], rows[k, s, e]
                    for m in range(len(row)):
                        own[m] += factor * row[m]


@njit(**KERNEL)
def write_sum(first, second, total):
    """Write the sum of two matrices.

    Args:
        first, second: They, shape (n, n).
        total: Takes the sum, same shape.
    """
    for i in range(len(total)):
        for j in range(len(total)):
            total[i, j] = first[i, j] + second[i, j]


class ReducedHourglass:
    """What resists the hour-glass modes of sampled hexahedra of one material.

    Attributes:
        scale: See `Hourglass`.
        start: See there.
        strains: y at the state that was taken last [m], shape (batch_count, 12 × BATCH).
        moduli: See there.
    """

    def __init__(
        self, gradients: np.ndarray, own: HourglassRows, lame: LameParameters, is_linear: bool,
        has_floor: bool,
    ):  # fmt: skip
        """Lay out the cells.

        Args:
            gradients: G in the order of the batches, shape (batch_count, 9, BATCH, width).
            own: Rows and fields of the cells.
            lame: Lamé's constants of small strains [Pa].
            is_linear: Whether the law is that of small displacements.
            has_floor: See `Hourglass`.
        """
        batch_count, _, _, width = gradients.shape
        count, _, modes = own.rows.shape
        padded = np.zeros((batch_count * BATCH, 3 * VECTORS, width), gradients.dtype)
        padded[:count, :, :modes] = own.rows
        rows = padded.reshape(batch_count, BATCH, 3 * VECTORS, width).transpose(0, 2, 1, 3)
        self._rows = np.ascontiguousarray(np.concatenate([gradients, rows], axis=1))
        moduli = own.weights[:, None, None] * hourglass_moduli(own.fields, lame)
        self.moduli = np.zeros((batch_count, ROWS_OF_MODULI * BATCH))
        self._floor = np.zeros((batch_count, BATCH))
        if count:
            self.moduli[:], self._floor[:] = map(flat_batches, divided_moduli(moduli, has_floor))
        self._is_linear = is_linear
        self._states = np.zeros((batch_count, ROWS * BATCH))
        self.strains, self._forces, self.start, self._pull = np.zeros(
            (4, batch_count, 3 * VECTORS * BATCH)
        )
        self._stresses = np.zeros((batch_count, ROWS * BATCH))
        self._changes = np.zeros_like(self._rows)
        self._stiffness = np.zeros((width, width), gradients.dtype)
        self._sum, self.scale = np.zeros((width, width), gradients.dtype), np.ones(1)

    def add_forces(self, coordinates: np.ndarray, forces: np.ndarray) -> None:
        """Take a state, and add rowsᵀ P.

        Args:
            coordinates: q [m], shape (width,).
            forces: On the coordinates [N], same shape; added to.
        """
        measure(self._rows, coordinates, self._states)
        find_strains(self._is_linear, self._states, self.strains)
        write_forces(self.moduli, self.scale, self.strains, self.start, self._pull, self._forces)
        find_stresses(self._is_linear, self._floor, self._states, self._forces, self._stresses)
        add_forces(self._rows, self._stresses, forces)

    def cell_forces(self) -> np.ndarray:
        """What each cell adds at the state that was taken last [N], shape (batch_count, BATCH, width)."""
        found = self._stresses.reshape(len(self._stresses), ROWS, BATCH, 1)
        return (found * self._rows).sum(axis=1)

    def added_to(self, stiffness: np.ndarray, projected: bool) -> np.ndarray:
        """The sum of a stiffness and that of the state that was taken last [N/m], (width, width).

        Args:
            stiffness: The other part, same shape.
            projected: True for a part that is never negative.
        """
        write_changes(
            self._is_linear, self.moduli, self.scale, self._floor, self._rows, self._states, self._forces,
            projected, self._changes,
        )  # fmt: skip
        width = self._rows.shape[3]
        multiply_transposed(
            self._rows.reshape(-1, width), self._changes.reshape(-1, width), self._stiffness
        )
        write_sum(stiffness, self._stiffness, self._sum)
        return self._sum

    def energy(self, coordinates: np.ndarray) -> float:
        """Potential at a state [J].

        Args:
            coordinates: q [m], shape (width,).
        """
        states, y = np.empty_like(self._states), np.empty_like(self.strains)
        measure(self._rows, coordinates, states)
        find_strains(self._is_linear, states, y)
        h = np.ascontiguousarray(states[:, 9 * BATCH :])
        return float(
            add_energies(self.moduli, self.scale, self._floor, h, y, self.start, self._pull)
        )

    def begin(self, coordinates: np.ndarray, rate: float) -> None:
        """Take where a step begins as the state without force, of a viscosity.

        Args:
            coordinates: q there [m], shape (width,).
            rate: s.
        """
        self.scale[0] = rate
        measure(self._rows, coordinates, self._states)
        find_strains(self._is_linear, self._states, self.start)


ROWS_OF_MODULI = (3 * VECTORS) ** 2
"""Entries of M."""
